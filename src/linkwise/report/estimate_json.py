"""The content of result.json for an estimate."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.argument_types import checked
from linkwise.errors import RecordError
from linkwise.estimates.estimate import Estimate
from linkwise.identification.force_error import nmse
from linkwise.model.structure import Link, Structure
from linkwise.records.record import Record


@checked
def result_of(estimate: Estimate, truth: Structure | None = None) -> dict[str, Any]:
    """Return the content of result.json for an estimate as plain data.

    Parameters
    ----------
    estimate : Estimate
        A result of `identify`.
    truth : Structure, optional
        The true structure, which adds "nmse_percent": the NMSE of the force of each link in % (paper Eq. 8), None where the
        record does not determine it.

    Returns
    -------
    dict
        The estimate as plain data, and the version of linkwise.

    Raises
    ------
    StructureError
        If the true structure lacks a link.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> result = lw.result_of(lw.identify(record, chain.unknown("nes"), method="weak"), chain)
    >>> result["status"], result["nmse_percent"]["nes1"] < 1.0
    ('converged', True)
    """
    result = {**estimate.to_dict(), "version": version("linkwise")}
    return result if truth is None else {**result, "nmse_percent": _errors(estimate, truth)}


def _errors(estimate: Estimate, truth: Structure) -> dict[str, float | None]:
    """NMSE in % of each identified force over the motion of the record; None where the record does not determine it."""
    return {
        link.name: _error(truth.link(link.name), link, estimate.record)
        for link in estimate.structure.links
        if link.name not in estimate.structure.modes
    }


def _error(true: Link, identified: Link, record: Record) -> float | None:
    try:
        return nmse(true, identified, record)
    except RecordError:  # an end without displacement, or a force that does not vary
        return None
