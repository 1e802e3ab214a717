"""Vibration absorption (paper section 4): the same structure with its sinks and without them."""

from __future__ import annotations

from typing import Unpack

import numpy as np

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.harvesters import SUFFIX
from linkwise.absorption.options import AbsorptionKeywords, AbsorptionOptions
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.rest_positions import rest_positions
from linkwise.absorption.result import Absorption, AbsorptionRun, Harvest, MassChange, MassDecay, SinkResult
from linkwise.absorption.runs import single_run
from linkwise.absorption.vibration import Vibration
from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.simulate import SimulatedMotion

Passages = tuple[Floats, ...]


def absorb(
    structure: Structure,
    options: AbsorptionOptions | None = None,
    *,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> Absorption:
    """Compare what a structure does with its sinks and without them.

    Parameters
    ----------
    structure : Structure
        The structure, all of its coefficients with a number.
    options : AbsorptionOptions, optional
        What is asked.
    progress : Progress
        Called with a `ProgressReport` before each of the two runs.
    **keywords
        In place of `options`: its fields `duration` (s, required), `rate` (Hz), `sinks`, `without`, `settle` and `harvesters`
        (N s/m by link), and what drives the structure, as in `simulate`: `release`, `impulses`, `forces`, `base`.

    Returns
    -------
    Absorption
        Decay and settling of the primary masses, the share of the energy that each link dissipates, and how often each
        sink crosses from well to well.

    Raises
    ------
    StructureError
        If a named link does not exist, a coefficient has no number, or the structure has no sinks.
    SimulationError
        If nothing moves, and as `simulate` does.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.absorb(lw.bnes_chain(2), duration=6.0, release={"v:m1": 1.0})
    >>> found.masses[0].name, found.to_dict()["sinks"]["nes1"]["crossings"]
    ('m1', 109)
    """
    return answer(Comparison.of(structure, AbsorptionOptions.given(options, keywords)), progress)


def answer(trial: Comparison, progress: Progress = silent) -> Absorption:
    """`absorb` for a question that stands."""
    progress(ProgressReport(0.0, "with sinks"))
    potentials = Potentials.of([trial.structure])
    one, vibration, passages = _side(trial, trial.schedule, potentials)
    progress(ProgressReport(0.5, "without sinks"))
    other, baseline, _ = _side(trial, trial.baseline_schedule, Potentials.of([trial.baseline.structure]))
    level = trial.options.settle * baseline.peak
    if not np.any(baseline.runs.v):
        raise SimulationError(
            f"with the sinks {trial.options.without} nothing moves, so there is nothing to compare with: the structure starts "
            "at rest in equilibrium; give a release, an impulse, a force or a motion of the base that moves a primary mass"
        )
    both = zip(_masses(vibration, level), _masses(baseline, level), strict=True)
    masses = tuple(
        MassChange(name, float(level[row, 0]), *pair)
        for row, (name, pair) in enumerate(zip(trial.primaries, both, strict=True))
    )
    return Absorption(
        manner=trial.options.without,
        settle=trial.options.settle,
        time=trial.times,
        masses=masses,
        sinks=_sinks(trial, one, passages, potentials.tops(0)),
        harvests=_harvests(trial, one),
        absorbing=trial.absorbing,
        with_sinks=one,
        without=other,
    )


def _side(
    trial: Comparison, schedule: RunSchedule, potentials: Potentials
) -> tuple[AbsorptionRun, Vibration, Passages]:
    """One of the two runs."""
    motion = SimulatedMotion.of(schedule)
    runs = single_run(motion, potentials.tops(0))
    columns = [schedule.structure.mass_names.index(name) for name in trial.primaries]
    vibration = Vibration(runs, columns, rest_positions([trial.resting_structure], trial.primaries))
    base = schedule.excitation.base
    where = None if base is None else base.value(schedule.times)
    side = AbsorptionRun(
        structure=schedule.structure,
        x=motion.displacement,
        v=motion.velocity,
        envelope=vibration.decay.envelope[..., 0],
        put_in=runs.put_in[:, 0] - potentials.floor[0],
        stored=(potentials.kinetic(runs.v) + potentials.stored(runs.x, where))[:, 0],
        dissipated=runs.heat[..., 0],
        horizon=motion.horizon,
    )
    return side, vibration, runs.passages[0]


def _masses(vibration: Vibration, level: Floats) -> list[MassDecay]:
    settled = vibration.settled(level)[:, 0]
    rates = vibration.decay.column(0).rate(level[:, 0])
    numbers = zip(
        vibration.rest[:, 0].tolist(),
        vibration.peak[:, 0].tolist(),
        vibration.rms[:, 0].tolist(),
        strict=True,
    )
    return [
        MassDecay(rest, peak, rms, _known(time), _known(decay))
        for (rest, peak, rms), time, decay in zip(numbers, settled, rates, strict=True)
    ]


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def _sinks(
    trial: Comparison, side: AbsorptionRun, passages: Passages, tops: list[Floats]
) -> tuple[SinkResult, ...]:
    names = [link.name for link in side.structure.links]
    before_horizon = np.inf if side.horizon is None else side.horizon
    base = trial.options.excitation.base
    d = side.structure.elongations(side.x, None if base is None else base.value(trial.times))
    found = []
    for sink in trial.sinks:
        number = names.index(sink.link)
        times, heights = passages[number], tuple(tops[number].tolist())
        share, before = side.share(sink.link), int(np.sum(times < before_horizon))
        found.append(SinkResult(sink, heights, share, d[:, number], times, before))
    return tuple(found)


def _harvests(trial: Comparison, side: AbsorptionRun) -> tuple[Harvest, ...]:
    found = []
    for link, damping in (trial.options.harvesters or {}).items():
        share = side.share(f"{link}{SUFFIX}")
        energy = share * side.total
        found.append(Harvest(link, damping, energy, energy / float(trial.times[-1]), share))
    return tuple(found)
