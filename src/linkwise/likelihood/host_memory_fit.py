"""Fits of structures with hosts whose links have memory: from starts that free runs bring close to the records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.sensors import SAMPLES
from linkwise.likelihood.starts.free_run_search import free_run_starts
from linkwise.likelihood.starts.free_runs import FreeRuns
from linkwise.likelihood.starts.host_memory import host_memory_starts
from linkwise.likelihood.valleys import Stages, fit_from_free_runs, fit_in_stages, fit_or_another
from linkwise.model.structure import Structure
from linkwise.progress import part, rising
from linkwise.records.record import Record
from linkwise.runtime import one_blas_thread
from linkwise.signals.base_frame import framed_records

_FREE_RUNS = 0.3  # part of the work
_INEXACT = (
    0.05**2
)  # part in power of the records: free runs that leave more are not of exact laws, or not near


def fit_of_memory_beside_hosts(
    records: Sequence[Record],
    structure: Structure,
    given: Mapping[str, float],
    options: LikelihoodOptions,
) -> LikelihoodFit:
    """The most likely parameters of a structure with hosts whose links have memory.

    Parameters
    ----------
    records : sequence of Record
        The records, with the same channels.
    structure : Structure
        The structure.
    given : mapping of str to float
        Starting values by name of the parameter.
    options : LikelihoodOptions
        The options.

    Returns
    -------
    LikelihoodFit
        The fit from free runs where they come close to the records, else the best from all starts.

    Raises
    ------
    IdentificationError
        If the records do not determine the motion, or the motion from none of the starts is finite.
    """
    progress = rising(options.progress)
    framed_ones = framed_records(records, structure, integrated=True)
    with one_blas_thread():
        valleys = host_memory_starts(framed_ones, structure, given)
        near = free_run_starts(framed_ones, structure, given, valleys, part(progress, 0.0, _FREE_RUNS))
    stages = Stages.of(records, structure, replace(options, progress=part(progress, _FREE_RUNS, 1.0)))
    fit = None
    if near:
        fit = fit_from_free_runs(stages, near[0], _nodes(framed_ones, structure, near[0].values))
    if fit is None:
        return fit_in_stages(stages, valleys)
    if near[0].misfit > _INEXACT:
        return fit
    return fit_or_another(fit, lambda: fit_in_stages(stages, valleys))


def _nodes(records: Sequence[Record], structure: Structure, values: Floats) -> Floats | None:
    """(2n + S, K) states of free runs from rest at the first sample of every segment; None where these are not so long."""
    runs = FreeRuns.of(records, structure, values)
    if any(len(run) < len(record) for run, record in zip(runs.records, records, strict=True)):
        return None
    return np.concatenate([states[:, ::SAMPLES] for states in runs.states(values)], axis=1)
