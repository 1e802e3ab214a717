"""The content of result.json for a discovery."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated, deprecated_keyword
from linkwise.discovery.result import Discovery
from linkwise.discovery.scoring import align_truth, term_score
from linkwise.model.structure import Structure
from linkwise.report.estimate_json import result_of


@deprecated_keyword("found", Deprecated("discovery", since="0.2.0", until="0.4.0"))
@checked
def discovery_of(discovery: Discovery, truth: Structure | None = None) -> dict[str, Any]:
    """Return the content of result.json for a discovery as plain data.

    Parameters
    ----------
    discovery : Discovery
        A result of `discover`.
    truth : Structure, optional
        The true structure, which adds "nmse_percent", the NMSE of each force in % (paper Eq. 8) or None where it does not
        exist, and "truth", the names of the terms that are right, missing and false.

    Returns
    -------
    dict
        The discovery as plain data, and the version of linkwise.

    Raises
    ------
    StructureError
        If the true structure has other masses.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> lw.discovery_of(lw.discover(record, {"m1": 1.0, "m2": 0.01}), chain)["truth"]["missing"]
    []
    """
    result = {**discovery.to_dict(), "version": version("linkwise")}
    if truth is None:
        return result
    score = term_score(discovery.structure, truth)
    compared = {
        "right": list(score.right),
        "missing": list(score.missing),
        "extra": list(score.extra),
        "missing_links": list(score.missing_links),
        "extra_links": list(score.extra_links),
    }
    aligned = result_of(discovery.estimate, align_truth(discovery.structure, truth))
    return {**result, "nmse_percent": aligned["nmse_percent"], "truth": compared}
