"""Vibration absorption (paper section 4): the same structure with its sinks and without them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Unpack

import numpy as np

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.harvesters import SUFFIX
from linkwise.absorption.potentials import Potentials
from linkwise.absorption.rest_positions import rest_positions
from linkwise.absorption.result import Absorption, AbsorptionRun, Harvest, MassChange, MassDecay, SinkResult
from linkwise.absorption.runs import single_run
from linkwise.absorption.vibration import Vibration
from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.model.excitation import Excitation
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.simulation.schedule import RunSchedule
from linkwise.simulation.simulate import ExcitationKeywords, SimulatedMotion

Passages = tuple[Floats, ...]


def absorb(
    structure: Structure,
    *,
    duration: float,
    rate: float | None = None,
    sinks: Sequence[str] = (),
    without: str = "removed",
    settle: float = 0.05,
    harvesters: Mapping[str, float] | None = None,
    progress: Progress = silent,
    **excitation: Unpack[ExcitationKeywords],
) -> Absorption:
    """What the sinks of a structure do for `duration` in s, against the same structure without them.

    `sinks` names their links; without names, every link with more than one stable well is one. They are "removed" with all
    that hangs on their masses, as in the paper, or "locked" where they start; `without` says which. A mass is settled when it
    stays below `settle` times its peak without sinks until the end, and has done so for the last 5 % at least; excursions
    are counted from the stable equilibrium where it ends. `harvesters` are dampers in N s/m in parallel to links. Output is at
    `rate` in Hz, by default 20 or more samples in a period of the fastest mode; `excitation` is as in `simulate`.

    Raises StructureError for a link that is not there, a coefficient without a number, no sinks; SimulationError where nothing
    moves, and as `simulate` does.
    """
    comparison = Comparison.of(
        structure,
        Excitation.of(**excitation),
        duration=duration,
        rate=rate,
        sinks=sinks,
        without=without,
        settle=settle,
        harvesters=harvesters,
    )
    return answer(comparison, progress)


def answer(trial: Comparison, progress: Progress = silent) -> Absorption:
    """`absorb` for a question that stands."""
    progress(ProgressReport(0.0, "with sinks"))
    potentials = Potentials.of([trial.structure])
    one, vibration, passages = _side(trial, trial.schedule, potentials)
    progress(ProgressReport(0.5, "without sinks"))
    other, baseline, _ = _side(trial, trial.baseline_schedule, Potentials.of([trial.baseline.structure]))
    level = trial.settle * baseline.peak
    if not np.any(baseline.runs.v):
        raise SimulationError(
            f"with the sinks {trial.manner} nothing moves, so there is nothing to compare with: the structure starts at rest "
            "in equilibrium; give a release, an impulse, a force or a motion of the base that moves a primary mass"
        )
    both = zip(_masses(vibration, level), _masses(baseline, level), strict=True)
    masses = tuple(
        MassChange(name, float(level[row, 0]), *pair)
        for row, (name, pair) in enumerate(zip(trial.primaries, both, strict=True))
    )
    return Absorption(
        manner=trial.manner,
        settle=trial.settle,
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
    base = trial.excitation.base
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
    for link, damping in trial.harvesters.items():
        share = side.share(f"{link}{SUFFIX}")
        energy = share * side.total
        found.append(Harvest(link, damping, energy, energy / float(trial.times[-1]), share))
    return tuple(found)
