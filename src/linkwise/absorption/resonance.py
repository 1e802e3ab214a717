"""The largest steady motion of the primary masses under a harmonic excitation, which a design keeps small."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from linkwise.absorption.absorb import Comparison
from linkwise.absorption.ensemble import AbsorptionQuantity
from linkwise.arrays import Floats
from linkwise.errors import SimulationError
from linkwise.model.excitation import Excitation, TimeFunction
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport
from linkwise.records.channel_units import unit_in
from linkwise.response.options import FORCE, ResponseOptions, shown_channels
from linkwise.response.respond import respond
from linkwise.response.result import Response
from linkwise.runtime import one_blas_thread

RESONANCE = "resonance"
_PERIODS = 100.0  # of the lowest frequency: a sweep that no duration is given for


@dataclass(frozen=True, eq=False)
class Resonance:
    """What is driven harmonically, and the C `channels` whose amplitudes are of one `unit`."""

    options: ResponseOptions
    unit: str

    @classmethod
    def of(cls, comparison: Comparison, options: ResponseOptions) -> Resonance:
        """That of the primary masses, or of what the options show.

        Raises SimulationError if what is shown does not exist or has several units.
        """
        structure = comparison.structure
        shown = options.show or [f"x:{name}" for name in comparison.primaries]
        channels = shown_channels(structure, shown)
        units = {unit_in(structure, channel) for channel in channels}
        if len(units) > 1:
            raise SimulationError(
                f"the resonance is the largest amplitude of {', '.join(channels)}, whose units differ "
                f"({', '.join(sorted(units))}); show one of them",
                arguments=("show",),
            )
        return cls(replace(options, show=channels), *units)

    @property
    def quantity(self) -> AbsorptionQuantity:
        """The row of the table of quantities."""
        shown = ", ".join(map(str, self.options.show))
        return AbsorptionQuantity(RESONANCE, self.unit, f"largest steady amplitude of {shown}", True)

    def response(self, structure: Structure, factor: float = 1.0) -> Response:
        """The response of a structure at the levels, times a factor."""
        return respond(
            structure, replace(self.options, levels=[factor * size for size in self.options.sizes])
        )

    def values(
        self, structures: Sequence[Structure], factor: float, progress: Progress, pool: Executor | None = None
    ) -> Floats:
        """(R,) the largest amplitudes of structures, side by side in a `pool`; NaN where no steady motion is found."""
        values = np.full(len(structures), np.nan)
        follow = partial(_largest_amplitude, self, factor)
        followed = map(follow, structures) if pool is None else pool.map(follow, structures)
        for number, value in enumerate(followed):
            values[number] = value
            progress(ProgressReport((number + 1) / len(structures), f"{len(structures)} response curves"))
        return values


@contextmanager
def curve_pool(workers: int | None, executor: Executor | None = None) -> Iterator[Executor | None]:
    """What follows response curves: an `executor` that is given, or processes, since threads would wait for each other's
    Python; None for a single one.
    """
    if executor is not None or workers is None or workers < 2:
        yield executor
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(workers, context, initializer=one_blas_thread) as pool:
        yield pool


def _largest_amplitude(resonance: Resonance, factor: float, structure: Structure) -> float:
    """The largest amplitude of what does not depart from it: stable periodic motion, and irregular motion.

    NaN where there is neither at a level, unstable motion alone having no amplitude that a test would show, or no motion.
    """
    try:
        response = resonance.response(structure, factor)
    except SimulationError:
        return np.nan
    largest = []
    for level in response.levels:
        sizes = [branch.amplitude[branch.stable].max() for branch in level.branches if branch.stable.any()]
        sizes += [0.5 * (motion.upper - motion.lower).max() for motion in level.irregular]
        largest.append(max(sizes, default=np.nan))
    return float(np.max(largest))


def sweep(options: ResponseOptions, duration: float | None) -> tuple[Excitation, float]:
    """The harmonic excitation at its largest level, swept over its frequencies, and the duration in s."""
    duration = duration or _PERIODS / options.hz[0]
    swept = TimeFunction(options.drive.sweep(options.sizes[-1], options.hz, duration))
    if options.drive.kind == FORCE:
        return Excitation(forces={options.drive.place: swept}), duration
    return Excitation(base=swept), duration
