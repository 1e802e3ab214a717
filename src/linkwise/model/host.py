"""Hosts: linear structures that are known by modes, with points to which links, sensors and forces are attached.

A mode r of a host is a coordinate q_r of unit modal mass, q_r'' + 2 zeta_r w_r q_r' + w_r^2 q_r = phi_r' F, with a shape
phi_r at the points; a point moves by sum_r phi_r q_r (METHODS section 11). In a structure a mode is a mass of 1 kg, and a
link of it to the ground with the law `MODE_LAW`.

An entry c of the damping matrix between the modes r and s is a force c q_s' on mode r, and c q_r' on mode s. A link has
one elongation, so that this is a pair of dampers, of c/2 on q_r + q_s and of -c/2 on q_r - q_s, which leave the damping
of each mode by itself as it is.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import StructureError, expect
from linkwise.model.coefficient import Coefficient, as_coefficient, by_constructor, index_of
from linkwise.model.law import Law
from linkwise.model.link import ANGLE, BASE, GROUND, LENGTH, Link, Mass, check_name


@dataclass(frozen=True)
class HostMode:
    """A mode of a host.

    Parameters
    ----------
    frequency : Coefficient or float
        Natural frequency in Hz; 0 for a rigid motion. A number is known.
    damping : Coefficient or float
        Damping as a part of the critical one.
    shape : mapping of str to float
        Mass-normalised shape at every point of the host, in 1/sqrt(kg); in rad/(m sqrt(kg)) where the point turns.
    shape_sigma : mapping of str to float, optional
        Standard deviations to which the shape is known, by point: Gaussian priors about `shape`, infinite where it is only a
        start. At points that are not named it is known exactly.
    rotations : set of str, optional
        The points whose displacement is a rotation in rad, and not in m.

    Raises
    ------
    StructureError
        If the frequency or the damping is negative, or the shape not finite.

    Examples
    --------
    >>> import linkwise as lw
    >>> mode = lw.model.HostMode(5.2, 0.01, {"tip": 1.0, "joint": 0.62})
    >>> mode.shape["joint"]
    0.62
    """

    frequency: Coefficient
    damping: Coefficient
    shape: Mapping[str, float] = field(hash=False)
    shape_sigma: Mapping[str, float] = field(hash=False)
    rotations: frozenset[str]
    __reduce__ = by_constructor

    def __init__(
        self,
        frequency: Coefficient | float,
        damping: Coefficient | float,
        shape: Mapping[str, float],
        shape_sigma: Mapping[str, float] = MappingProxyType({}),
        rotations: Collection[str] = (),
    ) -> None:
        vars(self).update(
            frequency=as_coefficient(frequency, "the frequency of a mode"),
            damping=as_coefficient(damping, "the damping of a mode"),
            shape=shape,
            shape_sigma=shape_sigma,
            rotations=frozenset(rotations),
        )
        expect("HostMode: shape", shape, Mapping)
        for quantity, unit, given in (("frequency", " Hz", self.frequency), ("damping", "", self.damping)):
            if given.value is not None and not given.value >= 0.0:
                got = f"{given.value!r}{unit}"
                raise StructureError(f"the {quantity} of a mode must not be negative, got {got}")
        for point, value in self.shape.items():
            expect(f"HostMode: shape[{point!r}]", value, float)
            if not math.isfinite(value):
                where = f'the shape of a mode at the point "{point}"'
                raise StructureError(f"{where} must be a finite number, got {value!r}")
        for point, sigma in self.shape_sigma.items():
            if point not in self.shape or not sigma > 0.0:
                raise StructureError(
                    f'the standard deviation of the shape at "{point}" must be positive, and its point one of the shape, '
                    f"got {sigma!r}"
                )
        for point in self.rotations:
            index_of(self.shape, point, "point", "points")
        for name in ("shape", "shape_sigma"):
            numbers = {point: float(value) for point, value in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(numbers))

    def shape_value(self, point: str) -> Coefficient:
        """The shape at a point, known or known to within.

        Parameters
        ----------
        point : str
            Its name in the host.

        Returns
        -------
        Coefficient
            The shape in 1/sqrt(kg), or in rad/(m sqrt(kg)).

        Raises
        ------
        StructureError
            If there is no such point.
        """
        value, sigma = index_of(self.shape, point, "point", "points"), self.shape_sigma.get(point)
        return Coefficient.number(value) if sigma is None else Coefficient.unknown(value, sigma=sigma)

    def with_shape(self, changes: Mapping[str, Coefficient]) -> HostMode:
        """The mode with other shapes at some points.

        Parameters
        ----------
        changes : mapping of str to Coefficient
            The shape by point; an unknown without a start keeps the present value as one.

        Returns
        -------
        HostMode
            The mode.
        """
        shape, sigma = dict(self.shape), dict(self.shape_sigma)
        for point, change in changes.items():
            shape[point] = shape[point] if change.value is None else change.value
            sigma.pop(point, None)
            if not change.known:
                sigma[point] = change.sigma
        return replace(self, shape=shape, shape_sigma=sigma)


Pair = tuple[int, int]
"""Two modes of a host by number, counted from 1, the lower first; the same twice for what damps one mode."""

DAMPING = "damping"
_BETWEEN_MODES = re.compile(rf"\.mode(\d+)[+-]mode(\d+)(\.{DAMPING})?$")
_OF_SUM, _OF_DIFFERENCE, _OF_ONE = (
    Law.parse(text, units={DAMPING: "N s/m"}) for text in ("0.5*damping*v", "-0.5*damping*v", "damping*v")
)


def checked_damping(
    given: Mapping[Pair, Coefficient | float], modes: int, where: str
) -> dict[Pair, Coefficient]:
    """The entries by pair, the lower mode first; an unknown without a start has 0 as one.

    Raises StructureError for modes that do not exist, or an entry that is given twice.
    """
    entries: dict[Pair, Coefficient] = {}
    for pair, value in given.items():
        first, second = sorted(pair)
        if not 1 <= first <= second <= modes:
            given_for = f"the modes {pair[0]} and {pair[1]}"
            raise StructureError(f"damping is given between {given_for}, of modes 1 to {modes}", where)
        if (first, second) in entries:
            raise StructureError(f"the damping between the modes {first} and {second} is given twice", where)
        entry = as_coefficient(value, "the damping between modes")
        if entry.value is None and entry.same_as is None:
            entry = replace(entry, value=min(max(0.0, entry.lower), entry.upper))
        entries[first, second] = entry
    return entries


def damping_link(host: str, pair: Pair) -> str:
    """Name of the link whose coefficient `damping` is the entry of a pair."""
    return f"{host}.mode{pair[0]}+mode{pair[1]}"


def is_between_modes(name: str) -> bool:
    """Whether a name is that of a damper between modes, or of its coefficient."""
    return _BETWEEN_MODES.search(name) is not None


def in_words(link: str) -> str:
    """Which damping a damper between modes is, and how a structure file asks for it.

    Raises ValueError for the name of another link.
    """
    between = _BETWEEN_MODES.search(link)
    if between is None:
        raise ValueError(f"{link} is no damper between modes")
    first, second = between[1], between[2]
    return (
        f"between the modes {first} and {second} of {link[: between.start()]} "
        f'(damping = [ {{ modes = [{first}, {second}], damping = "unknown" }} ] of that host)'
    )


def entries_of(matrix: Floats, where: str) -> dict[Pair, float]:
    """Entries of a whole damping matrix (n, n) in N s/m, without those that are 0.

    Raises StructureError unless it is symmetric and dissipates energy in every motion.
    """
    largest = float(np.abs(matrix).max(initial=0.0))
    if np.abs(matrix - matrix.T).max(initial=0.0) > 1e-6 * largest:
        raise StructureError("the damping matrix of the modes is not symmetric", where)
    if np.linalg.eigvalsh(matrix).min(initial=0.0) < -1e-6 * largest:
        raise StructureError("the damping matrix feeds energy into a motion of the modes", where)
    pairs = np.argwhere(np.triu(matrix)).tolist()
    return {(row + 1, column + 1): float(matrix[row, column]) for row, column in pairs}


MODE_LAW = Law.parse(
    "39.47841760435743*frequency**2*d + 12.566370614359172*damping*frequency*v",  # (2 pi)^2 and 4 pi, times 1 kg
    units={"frequency": "Hz", "damping": ""},
)
"""Force of a mode of unit modal mass; frequency in Hz, damping as a part of the critical one."""


DIRECTIONS = {ANGLE: re.compile(r"-?\d+r[xyz]"), LENGTH: re.compile(r"(-?\d+)[xyz]")}
"""Names of points of finite-element models by node and direction, by the unit of their displacement."""
_RESERVED = frozenset("()\"',;")  # beside those of every name: a point is part of the names of channels


@dataclass(frozen=True)
class Host:
    """A linear structure by its modes: a beam, a wing, what a modal test or a finite-element model describes.

    Its points, written ``"HOST.POINT"``, stand wherever a mass does: as ends of links, and places of sensors and forces.

    Parameters
    ----------
    name : str
        Name of the host.
    modes : tuple of HostMode
        Its modes, with shapes at the same points.
    notes : tuple of str, optional
        What to know of where it comes from, such as the error that the reduction of matrices leaves.
    damping : mapping of (int, int) to Coefficient or float, optional
        Entries of the modal damping matrix in N s/m, by two modes counted from 1: damping between modes, which a damping ratio
        for each cannot describe. An entry of a mode with itself, such as that of a rigid motion, needs a damping ratio of 0.

    Raises
    ------
    StructureError
        If it has no mode or no point, a mode lacks a point of another, or the damping of a mode is given twice.

    See Also
    --------
    Structure : Joins hosts, masses and links.

    Examples
    --------
    >>> import linkwise as lw
    >>> known = lw.Coefficient.number
    >>> wing = lw.Host("wing", (lw.model.HostMode(known(5.2), known(0.01), {"tip": 1.0, "joint": 0.62}),))
    >>> wing.points
    ('wing.tip', 'wing.joint')
    """

    name: str
    modes: tuple[HostMode, ...]
    notes: tuple[str, ...] = field(default=(), compare=False)
    damping: Mapping[Pair, Coefficient | float] = field(default_factory=dict, hash=False)
    __reduce__ = by_constructor

    def __post_init__(self) -> None:
        check_name(self.name, "host")
        where = f'host "{self.name}"'
        for number, mode in enumerate(self.modes):
            expect(f"{where}: modes[{number}]", mode, HostMode)
        damping = checked_damping(self.damping, len(self.modes), where)
        vars(self).update(damping=MappingProxyType(damping), modes=tuple(self.modes))
        if self.name in (GROUND, BASE) or "." in self.name:
            raise StructureError("a host is not named ground or base, and its name has no dot", where)
        if not self.modes:
            raise StructureError("a host needs at least one mode", where)
        points = tuple(self.modes[0].shape)
        if not points:
            raise StructureError("its modes have a shape at no point; name at least one", where)
        for number, mode in enumerate(self.modes, start=1):
            if set(mode.shape) != set(points):
                raise StructureError(
                    f"mode {number} has a shape at {', '.join(mode.shape) or 'no point'}, and the first mode at "
                    f"{', '.join(points)}; give every mode a number at every point",
                    where,
                )
        if any(mode.rotations != self.modes[0].rotations for mode in self.modes):
            raise StructureError("its modes differ in the points that turn", where)
        for name in (self.name, *points):
            check_name(name, "host or point")
            reserved = sorted(_RESERVED & set(name))
            if reserved:
                problem = f"{name!r} cannot be part of the name of a channel"
                raise StructureError(f"{problem}: leave out {' '.join(reserved)}", where)
            if f"{self.name}.{name}" in self.coordinates:
                raise StructureError(f'the point "{name}" has the name of a mode; choose another', where)
        for first, second in damping:
            if first == second and self.modes[first - 1].damping.value:
                message = f"the damping of mode {first} is given by a ratio and by an entry of the damping matrix; give one"
                raise StructureError(message, where)

    @property
    def points(self) -> tuple[str, ...]:
        """Names of its points in a structure, ``"HOST.POINT"``."""
        return tuple(f"{self.name}.{point}" for point in self.modes[0].shape)

    @property
    def rotations(self) -> tuple[str, ...]:
        """Names of those of its points in a structure whose displacement is a rotation in rad."""
        mode = self.modes[0]
        return tuple(f"{self.name}.{point}" for point in mode.shape if point in mode.rotations)

    @property
    def coordinates(self) -> tuple[str, ...]:
        """Names of its modes in a structure, ``"HOST.mode1"`` and so on."""
        return tuple(f"{self.name}.mode{number}" for number in range(1, len(self.modes) + 1))

    @property
    def entries(self) -> dict[Pair, Coefficient]:
        """The entries of `damping` as coefficients, the lower mode first."""
        where = "the damping between modes"
        return {pair: as_coefficient(entry, where) for pair, entry in self.damping.items()}

    @property
    def damping_links(self) -> dict[Pair, str]:
        """Names of the links, such as ``"HOST.mode1+mode2"``, whose coefficient is an entry of `damping`, by its modes."""
        return {pair: damping_link(self.name, pair) for pair in self.damping}

    @property
    def shown_links(self) -> tuple[str, ...]:
        """Names of the links of its modes, and of those with the entries of `damping`."""
        return (*self.coordinates, *self.damping_links.values())

    @property
    def negated(self) -> dict[str, str]:
        """Places that move as modes do in the other direction, with these modes: ends of the dampers between modes."""
        numbers = dict.fromkeys(second for first, second in self.damping if first != second)
        return {f"{self.name}.-mode{number}": self.coordinates[number - 1] for number in numbers}

    def shape(self, point: str) -> dict[str, float]:
        """Shape at a point.

        Parameters
        ----------
        point : str
            Name of the point, ``"HOST.POINT"``.

        Returns
        -------
        dict of str to float
            The shape of each mode there, in 1/sqrt(kg), by the name of the mode in a structure.

        Raises
        ------
        StructureError
            If there is no such point.
        """
        own = point.removeprefix(f"{self.name}.")
        values = (index_of(mode.shape, own, "point", "points") for mode in self.modes)
        return dict(zip(self.coordinates, values, strict=True))

    def with_units(
        self, units: Mapping[str, str], directions: Mapping[str, int | str] = MappingProxyType({})
    ) -> Host:
        """The host with the units "rad" or "m" of the displacement of some points.

        Parameters
        ----------
        units : mapping of str to str
            Units by point.
        directions : mapping of str to int or str, optional
            What points are in a finite-element model, by default their names: that of a node, such as "21ry", has one unit.

        Returns
        -------
        Host
            The same host with points that turn.

        Raises
        ------
        StructureError
            If there is no such point, or another unit, or one that is not of the direction.
        """
        rotations = set(self.modes[0].rotations)
        for point, unit in units.items():
            index_of(self.modes[0].shape, point, "point", "points")
            direction = str(directions.get(point, point))
            own = next((own for own, words in DIRECTIONS.items() if words.fullmatch(direction)), unit)
            if own != unit:
                raise StructureError(
                    f'units: the point "{point}" is the direction {direction}, which is in {own}, not in {unit}'
                )
            if unit not in (ANGLE, LENGTH):
                raise StructureError(
                    f'units: the point "{point}" is displaced in "rad" or "m", got {unit!r}; a record may be in other units, '
                    f"such as x:{self.name}.{point}[deg]"
                )
            (rotations.add if unit == ANGLE else rotations.discard)(point)
        return replace(
            self, modes=tuple(replace(mode, rotations=frozenset(rotations)) for mode in self.modes)
        )

    def known_to_within(
        self, *, frequency: float = 0.0, damping: float = 0.0, shape: float = 0.0, at_least: bool = False
    ) -> Host:
        """The host with values known to within parts of themselves, as Gaussian priors.

        What is unknown stays so. Errors of a shape do not vanish at a node, so its part is
        that of the largest value of the mode at the points; a value of exactly 0, as at a support or in a direction in which
        nothing moves, stays known.

        Parameters
        ----------
        frequency, damping : float, optional
            Standard deviations as parts of each value; 0 leaves the values known.
        shape : float, optional
            Standard deviation of shapes as a part of the largest absolute value of the mode.
        at_least : bool, optional
            Whether standard deviations that are smaller are raised to these; by default those that there are stay.

        Returns
        -------
        Host
            The host.

        Raises
        ------
        StructureError
            If a part is negative or not finite.

        Examples
        --------
        >>> import linkwise as lw
        >>> known = lw.Coefficient.number
        >>> wing = lw.Host("wing", (lw.model.HostMode(known(5.2), known(0.01), {"tip": 1.0, "joint": 0.62}),))
        >>> wing.known_to_within(frequency=0.01, shape=0.02).modes[0].shape_sigma["joint"]
        0.02
        """
        for quantity, part in (("frequency", frequency), ("damping", damping), ("shape", shape)):
            if not 0.0 <= part < math.inf:
                known = f"the part to within which the {quantity} is known"
                raise StructureError(f"{known} must not be negative, got {part!r}")
        modes = []
        for mode in self.modes:
            largest = shape * max(map(abs, mode.shape.values()))
            sigma = {point: largest for point, value in mode.shape.items() if value and largest}
            for point, own in mode.shape_sigma.items():
                sigma[point] = max(own, largest) if at_least else own
            of_frequency = _to_within(mode.frequency, frequency, at_least=at_least)
            of_damping = _to_within(mode.damping, damping, at_least=at_least)
            modes.append(replace(mode, frequency=of_frequency, damping=of_damping, shape_sigma=sigma))
        of_pairs = partial(_to_within, part=damping, lower=-math.inf, at_least=at_least)
        entries = {pair: of_pairs(entry) for pair, entry in self.entries.items()}
        return replace(self, modes=tuple(modes), damping=entries)

    def as_in(self, link: Callable[[str], Link]) -> Host:
        """The host with frequencies and damping as links of a structure have them.

        Parameters
        ----------
        link : callable
            Gives a link of the structure by its name, as `Structure.link` does.

        Returns
        -------
        Host
            The host.
        """
        own = [link(name).coefficients for name in self.coordinates]
        modes = tuple(
            replace(mode, frequency=given["frequency"], damping=given[DAMPING])
            for given, mode in zip(own, self.modes, strict=True)
        )
        damping = {pair: link(name).coefficients[DAMPING] for pair, name in self.damping_links.items()}
        return replace(self, modes=modes, damping=damping)

    def parts(self) -> tuple[tuple[Mass, ...], tuple[Link, ...]]:
        """The modes as masses of 1 kg, each with a link to the ground.

        Returns
        -------
        masses : tuple of Mass
            The modal coordinates.
        links : tuple of Link
            Their stiffness and damping, with the law `MODE_LAW`, and the dampers between them, of each pair that with the
            coefficient first, then the one that shares it.
        """
        masses = tuple(Mass(name, 1.0) for name in self.coordinates)
        links = [
            Link(name, (name, GROUND), MODE_LAW, {"frequency": mode.frequency, "damping": mode.damping})
            for name, mode in zip(self.coordinates, self.modes, strict=True)
        ]
        for pair, entry in self.entries.items():
            name, (first, second) = damping_link(self.name, pair), (self.coordinates[n - 1] for n in pair)
            if first == second:
                links.append(Link(name, (first, GROUND), _OF_ONE, {DAMPING: entry}))
                continue
            shared = Coefficient.shared(f"{name}.{DAMPING}")
            links += [
                Link(name, (first, f"{self.name}.-mode{pair[1]}"), _OF_SUM, {DAMPING: entry}),
                Link(f"{first}-mode{pair[1]}", (first, second), _OF_DIFFERENCE, {DAMPING: shared}),
            ]
        return masses, tuple(links)


def _to_within(given: Coefficient, part: float, lower: float = 0.0, *, at_least: bool) -> Coefficient:
    if not given.value or not part:
        return given
    sigma = part * abs(given.value)
    if given.known:
        return Coefficient.unknown(given.value, lower=lower, sigma=sigma)
    return replace(given, sigma=max(given.sigma, sigma)) if at_least else given


def rotations_of(hosts: Iterable[Host], masses: Iterable[Mass]) -> tuple[str, ...]:
    """The points of hosts and the masses that turn."""
    points = [point for host in hosts for point in host.rotations]
    return (*points, *[mass.name for mass in masses if mass.unit == ANGLE])


def with_modes(
    masses: tuple[Mass, ...], links: tuple[Link, ...], hosts: tuple[Host, ...]
) -> tuple[tuple[Mass, ...], tuple[Link, ...]]:
    """Masses and links, with those of the modes of hosts before them unless they are there already; StructureError if one
    has the name of a mode or a point of a host.
    """
    present = {mass.name for mass in masses}
    of_modes = {link.name for link in links if link.between == (link.name, GROUND)}
    new_masses: list[Mass] = []
    new_links: list[Link] = []
    named = [("mass", mass.name) for mass in masses] + [("link", link.name) for link in links]
    for host in hosts:
        for kind, name in named:
            is_mode = name in host.coordinates
            if name not in of_modes and (is_mode or (kind == "mass" and name in host.points)):
                part = f"mode {host.coordinates.index(name) + 1}" if is_mode else "a point"
                raise StructureError(
                    f'{part} of the host "{host.name}" has the same name, and names must be unique: rename the {kind} or '
                    "the host",
                    f'{kind} "{name}"',
                )
        if set(host.coordinates) <= present:
            continue
        own_masses, own_links = host.parts()
        new_masses += own_masses
        new_links += own_links
    return (*new_masses, *masses), (*new_links, *links)
