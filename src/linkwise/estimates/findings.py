"""What the record cannot tell, in sentences (METHODS section 7)."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from linkwise.estimates.link_estimate import LinkEstimate

_TOGETHER = 0.995  # correlation beyond which two coefficients are one piece of knowledge


def link_findings(found: LinkEstimate, supply: float | None) -> Iterator[str]:
    """Sentences on one identified link, which gives the mean power `supply` in W to the motion where that is beyond doubt."""
    yield from _unvisited(found)
    yield from _together(found)
    yield from _nothing(found)
    if supply is not None:
        yield (
            f"{found.link.name} gives energy to the motion, {supply:.3g} W on average, as no damper does. A force that is not "
            "in the record would look like that."
        )


def _unvisited(found: LinkEstimate) -> Iterator[str]:
    if not found.wells or not found.free:
        return
    low, high = found.d_range
    inside = [well.value for well in found.wells if low <= well.value <= high]
    if len(inside) == 1:
        yield (
            f"{found.link.name} never left the well at {inside[0]:+.4g} m (d from {low:.4g} to {high:.4g} m): its barrier and "
            "its other wells are extrapolated. Hit it harder."
        )
    elif 1 < len(inside) < len(found.wells):
        missed = ", ".join(f"{well.value:+.4g} m" for well in found.wells if not low <= well.value <= high)
        yield (
            f"{found.link.name} never reached the well at {missed} (d from {low:.4g} to {high:.4g} m): what is said of it is "
            "extrapolated."
        )
    elif not inside:
        yield (
            f"{found.link.name} reached none of its wells (d from {low:.4g} to {high:.4g} m): they are extrapolated. Record "
            "until it comes to rest, or start it from a well."
        )


def _together(found: LinkEstimate) -> Iterator[str]:
    if found.covariance is None:
        return
    scale = np.sqrt(np.maximum(found.covariance.diagonal(), np.finfo(float).tiny))
    correlation = found.covariance / np.outer(scale, scale)
    for i, one in enumerate(found.free):
        for j, two in enumerate(found.free[:i]):
            if abs(correlation[i, j]) > _TOGETHER:
                yield (
                    f"{found.link.name}: {two} and {one} move together (correlation {correlation[i, j]:+.4f}); the "
                    "record fixes a combination of them far better than each. A wider range of motion sets them apart."
                )


def _nothing(found: LinkEstimate) -> Iterator[str]:
    for each in found.coefficients:
        if each.interval is not None and each.interval[0] < 0.0 < each.interval[1]:
            error = each.standard_error or 0.0
            yield f"{each.name} cannot be told from zero: {each.value:.3g} within ±{error:.2g} {each.unit}."
