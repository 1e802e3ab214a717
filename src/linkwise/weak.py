"""From a record and a structure to weak equations, free of the bias that noise puts into them (METHODS section 4).

For mass i the equation of motion m x'' + sum_l B_il f_l - w = 0, multiplied by a test function phi and integrated over its
window, is a sum of known functions of the record, each times one number:

    m_i int phi'' x_i  +  sum_l B_il sum_a c_a int kernel_a h_a(d_l)  -  int phi w_i  =  0

The terms of the links are `atoms`; inertia and applied forces follow them as further rows.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from linkwise.atoms import Atom, Unknowns, link_atoms, needs_rates
from linkwise.errors import IdentificationError
from linkwise.motion import SeenMotion
from linkwise.noisebias import Biases, BiasPlan
from linkwise.record import Record
from linkwise.structure import BASE, GROUND, Structure
from linkwise.weakform import PHI, PHI_1, PHI_2
from linkwise.window import Window

Floats = NDArray[np.float64]

_FEWEST = 8  # windows
_RESOLVED = 1e-5  # of the motion: what the sums that stand for integrals tell of a smooth motion
_GROUND_END, _BASE_END, _NO_END = -1, -2, -3


@dataclass(frozen=True, eq=False)
class MassEquations:
    """The weak equations of one mass, one a window: signs * rows[terms], times the terms' numbers, sum to zero.

    `terms` (p,) are rows of the system, inertia among them; `biases` are in positions within `terms`; `valid` (R,) is 1 for
    windows without a missing sample and 0 for others, or None where all are valid.
    """

    mass: int
    terms: NDArray[np.intp]
    signs: Floats
    biases: Biases
    valid: Floats | None

    def matrix(self, rows: Floats) -> Floats:
        """(p, R) terms of this mass from `rows` (A, R) of the system; zero in windows that are not valid."""
        matrix = rows[self.terms] * self.signs[:, None]
        return matrix if self.valid is None else matrix * self.valid


@dataclass(frozen=True, eq=False)
class WeakEquations:
    """All weak equations of one record.

    Row a of `rows` (A, R) is multiplied by theta[parameter[a]] (nothing for -1) plus fixed[a]. Beside them what the windows
    saw: `atoms` made the first rows, `ends` (L, 2) are the mass indices of the links' ends (-1 ground, -2 base), `d`, `v`
    (L, R) smoothed elongations in m and rates in m/s, `acceleration` (n, R) in m/s2, `push` (R, n) in N (None: no force),
    `time` (R,) in s.
    """

    window: Window
    motion: SeenMotion
    atoms: tuple[Atom, ...]
    ends: NDArray[np.intp]
    parameters: tuple[str, ...]
    rows: Floats
    masses: tuple[MassEquations, ...]
    parameter: NDArray[np.intp]
    fixed: Floats
    d: Floats
    v: Floats
    acceleration: Floats
    push: Floats | None
    time: Floats

    @cached_property
    def variances(self) -> Floats:
        """Noise variance in m^2 by end: masses, then at -2 the base and at -1 the ground.

        Not below what sums over samples resolve of the integrals, so that a record without noise is not held to its rounding.
        """
        motion = self.motion
        power = np.einsum("ij,ij->i", motion.x, motion.x) / motion.x.shape[1]
        base = 0.0 if motion.base is None else float(np.mean(motion.base**2))
        found = np.append(motion.variance, motion.base_variance)
        return np.append(np.maximum(found, _RESOLVED**2 * np.append(power, base)), 0.0)

    @cached_property
    def _links_at(self) -> list[NDArray[np.intp]]:
        found: list[list[int]] = [[] for _ in range(len(self.acceleration))]
        for link, pair in enumerate(self.ends):
            for end in pair:
                if end >= 0:
                    found[end].append(link)
        return [np.array(links, dtype=int) for links in found]

    def neighbours(self, mass: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """The links that hold a mass, and what is at the other end of each (an index into `variances`)."""
        links = self._links_at[mass]
        return links, self.ends[links].sum(axis=1) - mass

    def numbers_of(self, equations: MassEquations) -> tuple[NDArray[np.intp], Floats, Floats]:
        """The parameters (s,) in the equation of one mass, and what multiplies its terms: (q, s) by them and (q,) fixed."""
        parameter = self.parameter[equations.terms]
        which = np.unique(parameter[parameter >= 0])
        by_parameter = (parameter[:, None] == which).astype(float)
        return which, by_parameter, self.fixed[equations.terms]


def weak_equations(
    record: Record,
    structure: Structure,
    motion: SeenMotion,
    *,
    window: Window | None = None,
    values: dict[str, float] | None = None,
) -> WeakEquations:
    """The weak equations of `structure` on `record` whose `motion` was read; the window is chosen where it is None.

    `values` are the present values of parameters that enter a law nonlinearly (else their starts). Raises
    IdentificationError where the record is too short.
    """
    window = window or Window.for_band(motion.highest, record.rate, motion.quiet)
    windows = window.rows(len(record))
    if windows < _FEWEST:
        raise IdentificationError(
            f"the record is too short: its {len(record)} samples hold {windows} windows of {window.length} samples, and "
            f"{_FEWEST} are the least; record for longer"
        )
    unknowns = Unknowns.of(structure, values or {})
    d = np.ascontiguousarray(structure.elongations(motion.x.T, motion.base).T)
    ends = _ends(structure)
    spread = np.append(
        motion.variance, [0.0, motion.base_variance, 0.0]
    )  # by end code: -1 ground, -2 base, -3 none
    rates = _rates(d, window) if needs_rates(structure, unknowns) else None
    atoms = link_atoms(structure, d, spread[ends].sum(axis=1), rates, unknowns)
    smooth = window.filter(d, window.kernels)
    inertia = window.filter(motion.x, window.kernels[PHI_2:])[0]
    forced = [i for i, name in enumerate(structure.mass_names) if f"force:{name}" in record.channels]
    pushes = (
        np.stack([record.channel(f"force:{structure.mass_names[i]}") for i in forced]) if forced else None
    )
    rows = [_link_rows(atoms, d, smooth, window), inertia]
    if pushes is not None:
        rows.append(-window.filter(np.nan_to_num(pushes), window.kernels[:1])[0])
    parameter, fixed = _numbers(structure, atoms, unknowns, len(forced))
    area = window.kernels[PHI].sum()
    masses = _mass_equations(structure, atoms, ends, spread, motion, window, forced, pushes)
    _require_whole_windows(masses, window)
    return WeakEquations(
        window=window,
        motion=motion,
        atoms=tuple(atoms),
        ends=ends,
        parameters=unknowns.names,
        rows=np.concatenate(rows),
        masses=masses,
        parameter=parameter,
        fixed=fixed,
        d=_sharpened(smooth, window),
        v=-smooth[PHI_1] / area,
        acceleration=inertia / area,
        push=None if pushes is None else _placed(-rows[-1] / area, forced, structure.size),
        time=record.start + (window.half + window.stride * np.arange(windows)) / record.rate,
    )


def _require_whole_windows(masses: tuple[MassEquations, ...], window: Window) -> None:
    whole = [equations.valid.sum() for equations in masses if equations.valid is not None]
    if len(whole) == len(masses) and whole and max(whole) < _FEWEST:
        raise IdentificationError(
            f"too many samples are missing: no mass has {_FEWEST} windows of {window.length} samples without one; fill single "
            "gaps before, or record again"
        )


def _ends(structure: Structure) -> NDArray[np.intp]:
    """(L, 2) mass indices of the ends of every link, negative codes for ground and base."""
    index = {name: i for i, name in enumerate(structure.mass_names)} | {GROUND: _GROUND_END, BASE: _BASE_END}
    return np.array([[index[end] for end in link.between] for link in structure.links], dtype=int).reshape(
        -1, 2
    )


def _rates(d: Floats, window: Window) -> Floats:
    """(L, N) v from d (L, N), held at the edges."""
    single = Window(window.half, 1, window.step)
    inner = single.filter(d, single.slope)[0]
    return np.pad(inner, ((0, 0), (window.half, window.half)), mode="edge")


def _placed(forces: Floats, forced: list[int], masses: int) -> Floats:
    """(R, n) applied forces from those of the forced masses (F, R)."""
    placed = np.zeros((forces.shape[1], masses))
    placed[:, forced] = forces.T
    return placed


def _sharpened(smooth: Floats, window: Window) -> Floats:
    """(L, R) elongations from their sums (3, L, R) under phi, phi', phi'': means without bias to the third order.

    The mean of a curve under phi is off by half its curvature times the second moment of phi; phi'' tells the curvature.
    """
    at = window.step * np.arange(-window.half, window.half + 1)
    phi = window.kernels[PHI]
    return np.asarray((smooth[PHI] - 0.5 * (phi @ at**2 / phi.sum()) * smooth[PHI_2]) / phi.sum())


def _link_rows(atoms: list[Atom], d: Floats, smooth: Floats, window: Window) -> Floats:
    """(atoms, R): sign * int kernel h of every atom; `smooth` (3, L, R) serves those that are d itself."""
    rows = np.empty((len(atoms), smooth.shape[2]))
    curved: dict[int, list[int]] = {PHI: [], PHI_1: []}
    for number, atom in enumerate(atoms):
        first = atom.chain[0]
        if atom.plain:
            rows[number] = smooth[atom.kernel, atom.link]
        elif isinstance(first, float):
            rows[number] = first * window.kernels[atom.kernel].sum()
        else:
            curved[atom.kernel].append(number)
    for kernel, which in curved.items():
        if which:
            signals = np.stack([np.asarray(atoms[number].chain[0]) for number in which])
            rows[which] = window.filter(signals, window.kernels[kernel : kernel + 1])[0]
    rows *= np.array([atom.sign for atom in atoms])[:, None]
    return rows


def _numbers(
    structure: Structure, atoms: list[Atom], unknowns: Unknowns, forces: int
) -> tuple[NDArray[np.intp], Floats]:
    """What multiplies the rows: parameter numbers (A,), -1 for none, and (A,) fixed; atoms, then masses, then forces."""
    parameter = [-1 if atom.parameter is None else atom.parameter for atom in atoms]
    fixed = [atom.fixed for atom in atoms]
    for index, mass in enumerate(structure.masses):
        place = unknowns.places.get((-1 - index, "mass"))
        parameter.append(-1 if place is None else place[0])
        fixed.append(float(mass.mass.value or 0.0) if place is None else 0.0)
    return np.array(parameter + [-1] * forces, dtype=int), np.array(fixed + [1.0] * forces)


def _mass_equations(
    structure: Structure,
    atoms: list[Atom],
    ends: NDArray[np.intp],
    spread: Floats,
    motion: SeenMotion,
    window: Window,
    forced: list[int],
    pushes: Floats | None,
) -> tuple[MassEquations, ...]:
    """The masses whose equation can be written: their own displacement and those of all their neighbours were seen."""
    at_mass: list[list[int]] = [[] for _ in range(structure.size)]
    for number, atom in enumerate(atoms):
        for end in ends[atom.link]:
            if end >= 0:
                at_mass[end].append(number)
    plan = BiasPlan(atoms, window)
    found = []
    for i, numbers in enumerate(at_mass):
        which = np.array(numbers, dtype=int)
        its = ends[[atoms[number].link for number in numbers]].reshape(-1, 2)
        neighbours = np.unique(its[its >= 0])
        if not motion.seen[[i, *neighbours]].all() or (motion.base is None and (its == _BASE_END).any()):
            continue
        signs = np.where(its[:, 0] == i, 1.0, -1.0)
        other = np.append(its.sum(axis=1) - i, _NO_END)
        covariance = spread[i] + np.where(other[:, None] == other, spread[other], 0.0)
        constant = plan.constant(which, covariance)
        found.append((i, which, signs, neighbours, constant, plan.varying(which, signs, covariance)))
    filtered = plan.filtered()
    equations = []
    for i, which, signs, neighbours, constant, varying in found:
        terms, signs = np.append(which, len(atoms) + i), np.append(signs, 1.0)
        if i in forced:
            terms = np.append(terms, len(atoms) + structure.size + forced.index(i))
            signs = np.append(signs, 1.0)
            constant = np.pad(constant, (0, 1))
        biases = Biases(constant, tuple((a, b, factor * filtered[key]) for a, b, key, factor in varying))
        lost = _lost(
            motion, [i, *neighbours], None if pushes is None or i not in forced else pushes[forced.index(i)]
        )
        valid = None if lost is None else _whole(lost, window)
        equations.append(MassEquations(i, terms, signs, biases, valid))
    return tuple(equations)


def _lost(motion: SeenMotion, masses: list[int], push: Floats | None) -> NDArray[np.bool_] | None:
    """(N,) where a sample is missing that the equation of a mass needs, or None where none is."""
    lost = None if motion.missing is None else motion.missing[masses].any(axis=0)
    if push is not None and np.isnan(push).any():
        lost = np.isnan(push) if lost is None else lost | np.isnan(push)
    return lost if lost is not None and lost.any() else None


def _whole(lost: NDArray[np.bool_], window: Window) -> Floats:
    """(R,) 1 for windows without a lost sample."""
    count = window.filter(lost[None].astype(float), np.ones((1, window.length)))[0, 0]
    return np.asarray(count < 0.5, dtype=float)
