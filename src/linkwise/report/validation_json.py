"""The content of validation.json."""

from __future__ import annotations

from importlib.metadata import version
from typing import Any

from linkwise.argument_types import checked
from linkwise.identification.validation.result import Validation


@checked
def validation_of(validation: Validation) -> dict[str, Any]:
    """Return the content of validation.json as plain data.

    Parameters
    ----------
    validation : Validation
        A result of `validate`.

    Returns
    -------
    dict
        The result as plain data, and the version of linkwise.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validation_of(lw.validate(record, chain))
    >>> result["free_run"], result["channels"]["x:m1"]["unit"]
    (True, 'm')
    """
    return {**validation.to_dict(), "version": version("linkwise")}
