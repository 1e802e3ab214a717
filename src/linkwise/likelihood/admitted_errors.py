"""Errors of sensors that a fit may have: calibrations by channel, and errors that its diagnosis names and the user admits."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.fit import LikelihoodFit, LikelihoodOptions
from linkwise.likelihood.segmentation import COMMON
from linkwise.text import near_miss

ALL = "all"
ADMISSIBLE = ("gain", "offset")
_LARGEST = (
    0.5  # relative deviation of a calibration: the first order tells no sensor that may show half or twice
)


def by_channel(calibration: Mapping[str, float], responses: Sequence[str]) -> dict[str, float]:
    """Relative deviations of gains by response channel, and of the common one; `ALL` stands for those that are not named.

    Raises IdentificationError for a channel that is not a response, or a deviation that is not small and positive.
    """
    for name, deviation in calibration.items():
        if name not in (*responses, ALL, COMMON):
            raise IdentificationError(
                f"no calibration of {name} can be stated{near_miss(name, responses)}: the record has the sensors "
                f'{", ".join(responses)}; "{ALL}" stands for each of them and "{COMMON}" for a factor that they share'
            )
        if not 0.0 < deviation <= _LARGEST:
            raise IdentificationError(
                f"the calibration of {name} must be a relative standard deviation above 0 and up to {_LARGEST:g}, "
                f"got {deviation:g}"
            )
    each = dict.fromkeys(responses, calibration[ALL]) if ALL in calibration else {}
    return each | {name: deviation for name, deviation in calibration.items() if name != ALL}


def estimate_with_admitted(
    fitted: Callable[[LikelihoodOptions], LikelihoodFit],
    options: LikelihoodOptions,
    kinds: Sequence[str],
    estimate: Callable[[LikelihoodFit], Estimate],
) -> Estimate:
    """The estimate by `options`, with errors of these `kinds` added one by one as long as the diagnosis names one first.

    Raises IdentificationError for a kind that cannot be admitted.
    """
    for kind in kinds:
        if kind not in ADMISSIBLE:
            raise IdentificationError(
                f'unknown error of a sensor "{kind}"{near_miss(kind, ADMISSIBLE)}; choose from {", ".join(ADMISSIBLE)}'
            )
    answer = estimate(fitted(options))
    while kinds and answer.diagnosis:
        instruments = [cause for cause in answer.diagnosis if cause.is_instrument]
        cause = instruments[0] if instruments else None
        if cause is None or cause.kind not in kinds:
            break
        present = options.offsets if cause.kind == "offset" else options.gains
        if cause.where in present:
            break
        widened = (*present, cause.where)
        is_offset = cause.kind == "offset"
        options = replace(options, offsets=widened) if is_offset else replace(options, gains=widened)
        answer = estimate(fitted(options))
    return answer
