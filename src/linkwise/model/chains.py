"""The chain of bistable nonlinear energy sinks of the paper (Eq. 1, Table 1)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link, Mass
from linkwise.model.structure import Structure

SPRING_LAW = "k*d + c*v"
SINK_LAW = "alpha*d + beta*d**3 + c*v"

LARGEST = 100_000  # masses: what a structure file and a computer's memory still take without delay

PerCell = float | Sequence[float]


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
    """The paper's chain of `n` masses, n even: n/2 cells of a primary mass and the bistable sink that it carries.

    Each parameter is a number for all cells or a sequence of n/2 numbers, one a cell, in kg, N/m, N s/m, N/m^3. Masses are m1
    (primary), m2 (its sink), m3, ...; links are spring1 (m1 to ground), nes1 (m2 to m1), spring2 (m3 to m1), nes2, ...
    Raises StructureError for n that is odd, below 2 or above `LARGEST`, and for a sequence of another length.
    """
    if isinstance(n, bool) or not isinstance(n, int | np.integer):
        raise StructureError(f"the number of masses must be a whole number, got {n!r}")
    if n > LARGEST:
        raise StructureError(f"a chain has at most {LARGEST} masses")
    if n < 2 or n % 2:
        raise StructureError(
            f"a chain of {n} masses cannot be: each cell has two, a primary mass and its sink, so n is even and at least 2"
        )
    given = {
        "primary_mass": primary_mass, "sink_mass": sink_mass, "k": k, "c": c, "sink_c": sink_c, "alpha": alpha, "beta": beta,
    }  # fmt: skip
    cells = {name: _per_cell(name, value, int(n) // 2) for name, value in given.items()}
    spring, sink = Law.parse(SPRING_LAW), Law.parse(SINK_LAW)
    masses: list[Mass] = []
    links: list[Link] = []
    for cell in range(int(n) // 2):
        of = {name: Coefficient.number(values[cell]) for name, values in cells.items()}
        primary, attached = f"m{2 * cell + 1}", f"m{2 * cell + 2}"
        below = f"m{2 * cell - 1}" if cell else GROUND
        masses += [Mass(primary, of["primary_mass"]), Mass(attached, of["sink_mass"])]
        links += [
            Link(f"spring{cell + 1}", (primary, below), spring, {"k": of["k"], "c": of["c"]}),
            Link(
                f"nes{cell + 1}",
                (attached, primary),
                sink,
                {"alpha": of["alpha"], "beta": of["beta"], "c": of["sink_c"]},
            ),
        ]
    return Structure(f"bistable chain of {n} masses", tuple(masses), tuple(links))


def _per_cell(name: str, given: PerCell, cells: int) -> list[float]:
    """`given` as one number a cell."""
    try:
        numbers = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise StructureError(f"{given!r} is neither a number nor a sequence of numbers", name) from None
    if numbers.ndim == 0:
        return [float(numbers)] * cells
    if numbers.shape != (cells,):
        raise StructureError(
            f"{numbers.size} numbers were given for {cells} cells; give one number for all, or one a cell",
            name,
        )
    return [float(number) for number in numbers]
