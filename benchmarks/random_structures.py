"""Structures that nobody tuned on: random trees of masses, with laws of four kinds, hit at random places."""

from dataclasses import dataclass

import numpy as np
from structures import link, structure

import linkwise as lw
from linkwise.errors import LinkwiseError

DURATION, RATE = 6.0, 1000.0

_FREQUENCIES = (8.0, 60.0)  # Hz of a link between its two masses alone
_DAMPING = (0.002, 0.02)  # of critical, likewise
_KINDS = {"linear": "k*d + c*v", "hardening": "k*d + k3*d**3 + c*v", "softening": "k*d + k3*d**3 + c*v",
          "bistable": "k*d + k3*d**3 + c*v"}  # fmt: skip


@dataclass(frozen=True, eq=False)
class Case:
    """A structure, the record of all displacements after the hits, without noise, and where it was hit."""

    structure: lw.Structure
    record: lw.Record
    release: dict[str, float]


def random_case(seed: int) -> Case:
    """3 to 8 masses over two decades, a random tree and up to two more links, one or two of them to the ground, of linear,
    hardening, softening and bistable laws; one to three masses are hit. The same seed gives the same case.

    A draw that runs away (softening links do when hit too hard) is drawn again.
    """
    rng = np.random.default_rng([seed, 20261121])
    while True:
        structure, release = draw_structure(rng)
        try:
            record = lw.simulate(structure, release=release, duration=DURATION, rate=RATE)
        except LinkwiseError:
            continue
        if np.isfinite(record.values).all() and np.abs(record.values).max() < 1.0:
            return Case(structure, record, release)


def draw_structure(
    rng: np.random.Generator, masses: tuple[int, int] = (3, 8)
) -> tuple[lw.Structure, dict[str, float]]:
    """A structure with `masses` from the first to the second number of masses, and the velocities that hits give it."""
    n = int(rng.integers(masses[0], masses[1] + 1))
    kilograms = 10.0 ** rng.uniform(-1.0, 1.0, n)
    pairs = [(i, int(rng.integers(-1 if i == 0 else 0, i)) if i else -1) for i in range(n)]
    free = [(i, j) for i in range(n) for j in range(-1, i) if (i, j) not in pairs]
    extra = rng.choice(len(free), size=min(int(rng.integers(0, 3)), len(free)), replace=False)
    pairs += [free[index] for index in sorted(extra)]
    order = rng.permutation(n)  # so that the ground is not always at the first mass
    names = [f"m{int(place) + 1}" for place in order]
    kinds = rng.choice(list(_KINDS), size=len(pairs))
    hit = rng.choice(n, size=int(rng.integers(1, min(3, n) + 1)), replace=False)
    release = {f"v:{names[i]}": float(rng.uniform(0.5, 2.0) * rng.choice([-1.0, 1.0])) for i in hit}
    linear = []
    for i, j in pairs:
        reduced = kilograms[i] if j < 0 else kilograms[i] * kilograms[j] / (kilograms[i] + kilograms[j])
        omega = 2.0 * np.pi * np.exp(rng.uniform(*np.log(_FREQUENCIES)))
        ratio = np.exp(rng.uniform(*np.log(_DAMPING)))
        linear.append({"k": reduced * omega**2, "c": 2.0 * ratio * reduced * omega})
    reach = _reach(kilograms, names, pairs, linear, release)
    laws = [
        _law(str(kind), numbers, largest, rng)
        for kind, numbers, largest in zip(kinds, linear, reach, strict=True)
    ]
    return _structure(kilograms, names, pairs, laws), release


def _law(
    kind: str, linear: dict[str, float], reach: float, rng: np.random.Generator
) -> tuple[str, dict[str, float]]:
    """Text and numbers of a law that bends within `reach` m: the cubic force there is a sizeable part of the linear one."""
    k, share = linear["k"], float(rng.uniform(0.3, 1.0))
    if kind == "linear":
        return _KINDS[kind], linear
    if kind == "softening":
        share *= -0.15
    if kind == "bistable":
        k *= -0.3
    return _KINDS[kind], {"k": k, "k3": share * linear["k"] / reach**2, "c": linear["c"]}


def _reach(
    kilograms: np.ndarray,
    names: list[str],
    pairs: list[tuple[int, int]],
    linear: list[dict[str, float]],
    release: dict[str, float],
) -> np.ndarray:
    """(L,) three standard deviations of the elongations while all laws are linear."""
    structure = _structure(kilograms, names, pairs, [(_KINDS["linear"], numbers) for numbers in linear])
    record = lw.simulate(structure, release=release, duration=1.0, rate=RATE)
    x = np.stack([record.channel(f"x:{name}") for name in structure.mass_names], axis=1)
    deviations: np.ndarray = np.std(structure.elongations(x), axis=0)
    return 3.0 * deviations


def _structure(
    kilograms: np.ndarray,
    names: list[str],
    pairs: list[tuple[int, int]],
    laws: list[tuple[str, dict[str, float]]],
) -> lw.Structure:
    masses = dict(sorted(zip(names, kilograms.tolist(), strict=True), key=lambda mass: int(mass[0][1:])))
    links = []
    for (i, j), (law, numbers) in zip(pairs, laws, strict=True):
        ends = f"{names[i]}-{'ground' if j < 0 else names[j]}"
        links.append(link(ends, ends, law, **{key: float(value) for key, value in numbers.items()}))
    return structure(masses, *links, name="random structure")
