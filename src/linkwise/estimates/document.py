"""Estimates of links and coefficients as plain data, for JSON."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity, LinkEstimate
from linkwise.model.parameters import SHAPE


def coefficient_document(coefficient: CoefficientEstimate) -> dict[str, Any]:
    """A coefficient as plain data.

    Parameters
    ----------
    coefficient : CoefficientEstimate
        The coefficient.

    Returns
    -------
    dict
        Value, unit and, of unknown ones, standard error and interval.
    """
    document: dict[str, Any] = {
        "value": coefficient.value,
        "unit": coefficient.unit,
        "known": coefficient.known,
    }
    if not coefficient.known:
        document["standard_error"] = coefficient.standard_error
        document["interval"] = None if coefficient.interval is None else list(coefficient.interval)
    return document


def _derived(quantity: DerivedQuantity) -> dict[str, Any]:
    return {
        "value": quantity.value,
        "unit": quantity.unit,
        "interval": None if quantity.interval is None else list(quantity.interval),
    }


def link_document(link: LinkEstimate) -> dict[str, Any]:
    """A link as plain data.

    Parameters
    ----------
    link : LinkEstimate
        The link.

    Returns
    -------
    dict
        Name, ends, law, the rates and units of its states, coefficients and ranges, and wells, in-well frequencies and barrier
        where there are any.
    """
    document: dict[str, Any] = {
        "name": link.link.name,
        "between": list(link.link.between),
        "law": link.link.law.text,
        "coefficients": {c.name.rpartition(".")[2]: coefficient_document(c) for c in link.coefficients},
        "range": {"d": list(link.d_range), "v": list(link.v_range)},
    }
    if link.link.law.states:
        units = link.link.law.state_units
        document["states"] = {
            rate.name: {"rate": rate.text, "unit": units[rate.name].replace("?", "")}
            for rate in link.link.law.rates
        }
    if link.wells:
        document["wells"] = [{"d": well.value, "interval": _derived(well)["interval"]} for well in link.wells]
        document["in_well_frequencies"] = [_derived(frequency) for frequency in link.frequencies]
    if link.barrier is not None:
        document["barrier"] = _derived(link.barrier)
    return document


def mode_document(mode: LinkEstimate, shapes: Sequence[CoefficientEstimate] = ()) -> dict[str, Any]:
    """A mode of a host as plain data.

    Parameters
    ----------
    mode : LinkEstimate
        The mode.
    shapes : sequence of CoefficientEstimate, optional
        Shapes that were estimated, of all modes.

    Returns
    -------
    dict
        Its name, frequency and damping, and where shapes were estimated those of the mode, by point.
    """
    coefficients = {c.name.rpartition(".")[2]: coefficient_document(c) for c in mode.coefficients}
    start = f"{mode.link.name}.{SHAPE}"
    own = {c.name.removeprefix(start): coefficient_document(c) for c in shapes if c.name.startswith(start)}
    return {"name": mode.link.name, **coefficients, **({"shape": own} if own else {})}
