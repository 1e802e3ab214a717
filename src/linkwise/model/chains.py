"""The chain of bistable nonlinear energy sinks of the paper (Eq. 1, Table 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.errors import StructureError
from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link, Mass
from linkwise.model.structure import Structure

SPRING_LAW = "k*d + c*v"
SINK_LAW = "alpha*d + beta*d**3 + c*v"

LARGEST = 100_000  # masses: what a structure file and a computer's memory still take without delay

PerCell = float | Sequence[float]  # one number for all cells, or one for each


def bnes_chain(
    n: int,
    *,
    primary_mass: PerCell = 1.0,
    sink_mass: PerCell = 0.01,
    k: PerCell = 30000.0,
    c: PerCell = 1.0,
    sink_c: PerCell = 0.02,
    alpha: PerCell = -100.0,
    beta: PerCell = 1e6,
) -> Structure:
    """The chain of bistable nonlinear energy sinks of the paper (its Eq. 1 and Table 1).

    Masses are m1 (primary), m2 (its sink), m3, m4, ...; links are spring1 (m1 to ground), nes1 (m2 to m1), spring2 (m3 to
    m1), nes2 and so on. The springs have the law ``k*d + c*v``, the sinks ``alpha*d + beta*d**3 + c*v``.

    Parameters
    ----------
    n : int
        Number of masses, even: n/2 cells of a primary mass and its sink.
    primary_mass, sink_mass : float or sequence of n/2 floats
        Masses in kg.
    k, c : float or sequence of n/2 floats
        Stiffness in N/m and damping in N s/m of the springs.
    sink_c, alpha, beta : float or sequence of n/2 floats
        Damping in N s/m, linear stiffness in N/m and cubic stiffness in N/m^3 of the sinks.

    Returns
    -------
    Structure
        The chain, with all coefficients known.

    Raises
    ------
    StructureError
        If n is odd, below 2 or too large, or a sequence does not have n/2 numbers.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(4)
    >>> [link.name for link in chain.links]
    ['spring1', 'nes1', 'spring2', 'nes2']
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer):
        raise StructureError(f"the number of masses must be an integer, got {n!r}")
    if n > LARGEST:
        raise StructureError(f"the number of masses must be at most {LARGEST}")
    if n < 2 or n % 2:
        raise StructureError(
            f"the number of masses must be even and at least 2, since each cell has a primary mass and a sink; got {n}"
        )
    given = {
        "primary_mass": primary_mass, "sink_mass": sink_mass, "k": k, "c": c, "sink_c": sink_c, "alpha": alpha, "beta": beta,
    }  # fmt: skip
    cells = {name: _per_cell(name, value, int(n) // 2) for name, value in given.items()}
    spring, sink = Law.parse(SPRING_LAW), Law.parse(SINK_LAW)
    masses: list[Mass] = []
    links: list[Link] = []
    for cell in range(int(n) // 2):
        numbers = {name: values[cell] for name, values in cells.items()}
        primary, attached = f"m{2 * cell + 1}", f"m{2 * cell + 2}"
        below = f"m{2 * cell - 1}" if cell else GROUND
        masses += [Mass(primary, numbers["primary_mass"]), Mass(attached, numbers["sink_mass"])]
        links += [
            Link(f"spring{cell + 1}", (primary, below), spring, {"k": numbers["k"], "c": numbers["c"]}),
            Link(
                f"nes{cell + 1}",
                (attached, primary),
                sink,
                {"alpha": numbers["alpha"], "beta": numbers["beta"], "c": numbers["sink_c"]},
            ),
        ]
    return Structure(f"bistable chain of {n} masses", tuple(masses), tuple(links))


def _per_cell(name: str, given: PerCell, cells: int) -> list[float]:
    """`given` as one number for each cell."""
    try:
        numbers = np.asarray(given, dtype=float)
        if numbers.shape not in ((), (cells,)):
            raise ValueError
        return list(np.broadcast_to(numbers, cells).tolist())
    except (TypeError, ValueError):
        raise StructureError(
            f"expected one number, or one for each of {cells} cells, got {given!r}", name
        ) from None
