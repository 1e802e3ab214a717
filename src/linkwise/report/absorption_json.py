"""The content of absorption.json."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.absorption.intervals import AbsorptionIntervals
from linkwise.absorption.map_result import AbsorptionMap
from linkwise.absorption.result import Absorption
from linkwise.argument_types import checked
from linkwise.deprecation import Deprecated, deprecated_keyword


@deprecated_keyword("found", Deprecated("result", since="0.2.0", until="0.4.0"))
@checked
def absorption_of(result: Absorption | AbsorptionIntervals | AbsorptionMap) -> dict[str, Any]:
    """Return the content of absorption.json as plain data.

    Parameters
    ----------
    result : Absorption, AbsorptionIntervals or AbsorptionMap
        A result of `absorb`, `absorption_intervals` or `absorption_map`.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> result = lw.absorb(lw.bnes_chain(2), duration=2.0, release={"v:m1": 1.0})
    >>> lw.absorption_of(result)["trusted"]
    True
    """
    return {**result.to_dict(), "version": version("linkwise")}
