"""The memory that a fit takes, asked for before the work."""

from __future__ import annotations

from linkwise.errors import IdentificationError
from linkwise.likelihood.shooting.neighbourhoods import MANY
from linkwise.runtime import available_memory

_BLOCKS = 4  # of a node with itself, or with the border, that are kept at the same time
_LOCAL = 4000  # bytes of a state with its neighbours, of two linearisations


def fit_bytes(segments: int, masses: int, states: int, border: int) -> int:
    """Least memory of a fit.

    Parameters
    ----------
    segments, masses, states, border : int
        Numbers of segments, masses, states of a node, and unknowns of the border.

    Returns
    -------
    int
        Bytes.
    """
    if masses < MANY:
        return 8 * _BLOCKS * segments * states * (states + border)
    return segments * states * (8 * states + _LOCAL)


def require_room(segments: int, masses: int, states: int, border: int, *, free: int | None = None) -> None:
    """Refuse a fit that the memory cannot hold.

    Parameters
    ----------
    segments, masses, states, border : int
        As of `fit_bytes`.
    free : int, optional
        Bytes that are free; those of this machine by default.

    Raises
    ------
    IdentificationError
        If the fit needs more.
    """
    needed = fit_bytes(segments, masses, states, border)
    free = available_memory() if free is None else free
    if needed > free:
        raise IdentificationError(
            f"maximum likelihood for {masses} masses over {segments} segments of the record needs {needed / 1e9:.3g} GB, and "
            f"{free / 1e9:.3g} GB are free: fit a shorter part of the record, fewer records together, or take the weak form"
        )
