"""Vibration absorption (paper section 4): a structure with its sinks and without them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Unpack

import numpy as np

from linkwise.absorption.comparison import Comparison
from linkwise.absorption.motion import Vibration
from linkwise.absorption.options import AbsorptionKeywords, AbsorptionOptions
from linkwise.absorption.result import Absorption, AbsorptionRun, Harvest, MassChange, MassDecay, SinkResult
from linkwise.absorption.sinks import SUFFIX
from linkwise.absorption.wells import Potentials, Runs, rest_positions, single_run
from linkwise.arrays import Floats, finite
from linkwise.errors import SimulationError, expect, options_given
from linkwise.expression import Expression
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, silent
from linkwise.simulation.batch import SimulatedMotion
from linkwise.simulation.run import RunSchedule


def absorb(
    structure: Structure,
    options: AbsorptionOptions | None = None,
    *,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> Absorption:
    """Compare the vibration of a structure with its sinks and without them.

    Parameters
    ----------
    structure : Structure
        The structure, every coefficient a number or a start.
    options : AbsorptionOptions, optional
        What to simulate.
    progress : Progress
        Called with a `ProgressReport` before each of the two runs.
    **keywords
        In place of `options`: its fields `duration` (s, required), `rate` (Hz), `sinks`, `without`, `settle` and `harvesters`
        (N s/m by link), and the excitation, as in `simulate`: `release`, `impulses`, `forces`, `base`.

    Returns
    -------
    Absorption
        Decay and settling of the primary masses, the share of the energy that each link dissipates, and the crossings of
        each sink between its wells.

    Raises
    ------
    StructureError
        If a link does not exist, a coefficient is unknown and has no start, or there are no sinks.
    SimulationError
        If nothing moves without the sinks, and as `simulate`.
    TypeError
        If `structure` is no `Structure`.

    See Also
    --------
    absorption_intervals : The same for an identified structure, with intervals.
    absorption_map : The same over a grid of parameters.

    Examples
    --------
    >>> import linkwise as lw
    >>> found = lw.absorb(lw.bnes_chain(2), duration=6.0, release={"v:m1": 1.0})
    >>> found.masses[0].name, len(found.sinks[0].crossings)
    ('m1', 109)
    """
    expect("absorb(structure): structure", structure, Structure)
    return compare(Comparison.of(structure, options_given(AbsorptionOptions.of, options, keywords)), progress)


def compare(comparison: Comparison, progress: Progress = silent) -> Absorption:
    """Make both runs of a comparison."""
    progress(ProgressReport(0.0, "with sinks"))
    potentials = Potentials.of([comparison.structure])
    with_sinks, vibration, runs = _run(comparison, comparison.schedule, potentials, comparison.powers)
    progress(ProgressReport(0.5, "without sinks"))
    of_rest = Potentials.of([comparison.baseline.structure])
    without, baseline, _ = _run(comparison, comparison.baseline_schedule, of_rest, {})
    level = comparison.options.settle * baseline.decay.peak
    if not np.any(baseline.runs.v):
        raise SimulationError(
            f"with the sinks {comparison.options.without} nothing moves, so there is nothing to compare "
            "with: the structure starts at rest in equilibrium; give a release, an impulse, a force or a motion of the base "
            "that moves a primary mass"
        )
    decays = zip(
        comparison.primaries,
        level[:, 0].tolist(),
        _decays(vibration, level),
        _decays(baseline, level),
        strict=True,
    )
    return Absorption(
        removal=comparison.options.without,
        settle=comparison.options.settle,
        time=comparison.times,
        masses=tuple(MassChange(*of_mass) for of_mass in decays),
        sinks=_sink_results(comparison, with_sinks, runs.crossings[0], potentials.tops(0)),
        harvests=_harvests(comparison, with_sinks, runs),
        absorbing=comparison.absorbing,
        with_sinks=with_sinks,
        without=without,
    )


def _run(
    comparison: Comparison, schedule: RunSchedule, potentials: Potentials, powers: Mapping[str, Expression]
) -> tuple[AbsorptionRun, Vibration, Runs]:
    """One of the two runs, the vibration of its primary masses, and the run with its crossings and what harvesters took."""
    motion = SimulatedMotion.of(schedule)
    runs = single_run(motion, potentials.tops(0), powers)
    positions = rest_positions([comparison.resting_structure], comparison.primaries)
    vibration = Vibration(runs, [schedule.structure], comparison.primaries, positions)
    x_base = schedule.excitation.base_at(schedule.times)
    run = AbsorptionRun(
        structure=schedule.structure,
        x=motion.displacement,
        v=motion.velocity,
        envelope=vibration.decay.envelope[..., 0],
        supplied=runs.supplied[:, 0] - potentials.floor[0],
        stored=(potentials.kinetic(runs.v) + potentials.stored(runs.x, x_base))[:, 0],
        dissipated=runs.dissipated[..., 0],
        horizon=motion.horizon,
    )
    return run, vibration, runs


def _decays(vibration: Vibration, level: Floats) -> list[MassDecay]:
    """The decay of each primary mass; `level` (P, 1) m."""
    of_run = vibration.decay.of_run(0)
    settled, rates = (map(finite, column(level[:, 0])) for column in (of_run.settled, of_run.rate))
    sizes = (vibration.rest[:, 0].tolist(), of_run.peak.tolist(), vibration.rms[:, 0].tolist())
    return [MassDecay(*row) for row in zip(*sizes, settled, rates, strict=True)]


def _sink_results(
    comparison: Comparison, run: AbsorptionRun, crossed: tuple[Floats, ...], tops: list[Floats]
) -> tuple[SinkResult, ...]:
    names = [link.name for link in run.structure.links]
    horizon = np.inf if run.horizon is None else run.horizon
    d = run.structure.elongations(run.x, comparison.options.excitation.base_at(comparison.times))
    results = []
    for sink in comparison.sinks:
        number = names.index(sink.link)
        crossings, before = crossed[number], int(np.sum(crossed[number] < horizon))
        own_tops, share = tuple(tops[number].tolist()), run.share(sink.link)
        results.append(SinkResult(sink, own_tops, share, d[:, number], crossings, before))
    return tuple(results)


def _harvests(comparison: Comparison, run: AbsorptionRun, runs: Runs) -> tuple[Harvest, ...]:
    harvests, duration = [], float(comparison.times[-1])
    for link, given in (comparison.options.harvesters or {}).items():
        if isinstance(given, str):
            energy = float(runs.delivered[link][0])
            harvest = Harvest(link, None, energy, energy / duration, energy / run.total, given)
        else:
            share = run.share(f"{link}{SUFFIX}")
            harvest = Harvest(link, given, share * run.total, share * run.total / duration, share)
        harvests.append(harvest)
    return tuple(harvests)
