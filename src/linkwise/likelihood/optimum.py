"""Where a fit ended, kept so that one can look around it: without the orbit, which any look evaluates anew."""

from __future__ import annotations

from dataclasses import dataclass

from linkwise.likelihood.loss import Loss
from linkwise.likelihood.segments import Iterate, Scales, Segments


@dataclass(frozen=True, eq=False)
class Optimum:
    """The most likely `point` of `segments` at relaxation `q`; `noise` is the factor on the deviations in `scales`."""

    segments: Segments
    point: Iterate
    scales: Scales
    q: float
    noise: float
    loss: Loss
