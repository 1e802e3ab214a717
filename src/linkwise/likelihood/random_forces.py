"""Random forces that no channel shows, or shows with noise: which masses they act on, and the structure with them.

Noise of the recorded motion of the base is such a force, too. In coordinates relative to the base, an error e of its
acceleration is a force m e on every mass, and -e in what an absolute accelerometer shows beside these coordinates. In
coordinates at rest, an error of its displacement is an elongation of all links that end there; that part of it which acts
through its rate, on dampers, is left out: at resonance it is the damping ratio times two of the rest.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import near_miss
from linkwise.errors import IdentificationError, expect
from linkwise.estimates.causes import RandomForceEstimate
from linkwise.expression import symbols
from linkwise.likelihood.shooting.system import System
from linkwise.likelihood.terms import (
    Disturbance,
    HighPass,
    Stated,
    Term,
    late_beside_clocks,
    numbers_by_channel,
)
from linkwise.model.law import Law, LinkState
from linkwise.model.link import BASE, GROUND, Link
from linkwise.model.named_laws import LAG
from linkwise.model.structure import Structure
from linkwise.records.channel import HELD
from linkwise.records.channel_units import unit_in
from linkwise.records.record import Record
from linkwise.signals.base_frame import FramedRecord, framed
from linkwise.signals.noise import noise_deviations

ALL = "all"
_INPUT = "force:"
# of the force of inertia, by root mean square: where the search for an ambient force starts
_FIRST_GUESS = 0.3
_FIRST_NOISE = 0.01  # of an input: where the search for the noise of its channel starts
NOISIEST_INPUT = 0.15
"""Of an input, by root mean square: noise of 20 dB is 0.1, which a record of some seconds shows to within a third. A level
above it may be the input itself, which fills the band, or an error of the laws."""
_ROUNDING = 1e-6  # of an input: a level below it is that of rounded numbers
_HELD_STATE = Law.parse("-z", {"z": LinkState("0*rate*z", unit="N")})
"""Law of a link to the ground that carries a force; the force is constant within a segment."""

_OF_BASE = (f"x:{BASE}", f"a:{BASE}")


@dataclass(frozen=True)
class HarmonicForce:
    """A force in a `unit` on a `mass`, the `number` in its structure, with a `frequency` in Hz.

    `amplitudes` are those of a cosine and a sine from the middle of each record, none where they are not found yet.
    """

    mass: str
    number: int
    frequency: float
    unit: str
    amplitudes: tuple[tuple[float, float], ...] = ()

    @classmethod
    def on(cls, mass: str, frequency: float, structure: Structure) -> HarmonicForce:
        """One on a mass of a structure, where the mass turns a moment, with amplitudes that are not found yet."""
        number = structure.mass_names.index(mass)
        return cls(mass, number, float(frequency), unit_in(structure, f"{_INPUT}{mass}"))

    def acting(self, time: Floats, record: int) -> Floats:
        """(N,) the force at times (N,) in s from the middle of the record with this number."""
        (a, b), phase = self.amplitudes[record], 2.0 * np.pi * self.frequency * time
        return np.asarray(a * np.cos(phase) + b * np.sin(phase))


@dataclass(frozen=True)
class RandomForce:
    """A white random force on a mass, or the noise of the base.

    Attributes
    ----------
    place : str
        The mass, or the channel of the base.
    deviation : float or None
        Of the noise of a channel the standard deviation of a sample in N, or in the unit of the base; of an ambient force its
        one-sided amplitude spectral density in N/sqrt(Hz); None if it is to be found.
    ambient : bool
        Whether it is an ambient force.
    unit : str
        N of a force, N m of a moment, m or m/s^2 of a base.
    """

    place: str
    deviation: float | None
    ambient: bool
    unit: str

    @property
    def of_base(self) -> bool:
        """Whether it is the noise of a channel of the base."""
        return self.place in _OF_BASE

    @property
    def where(self) -> str:
        """The mass of an ambient force, else the channel."""
        return self.place if self.ambient or self.of_base else f"{_INPUT}{self.place}"


def random_forces(
    ambient: Stated, input_noise: Stated, record: Record, structure: Structure
) -> tuple[RandomForce, ...]:
    """The random forces that a user states, in the order of the masses, that of the base last.

    Raises IdentificationError for an unknown mass or channel, a deviation that is not positive, a mass named in both, and
    noise of the base that cannot be allowed for.
    """
    names = structure.places
    if structure.hosts and (ambient or input_noise):
        raise IdentificationError(
            "random forces on hosts are not supported: leave the ambient forces and input noise out"
        )
    forces = {}
    for name, value in _by_name(ambient, names).items():
        if name not in names:
            raise IdentificationError(
                f"no ambient force can act on {name}{near_miss(name, names)}: the masses are {', '.join(names) or 'none'}; "
                f'"{ALL}" stands for each of them',
                arguments=("ambient",),
            )
        unit = unit_in(structure, f"{_INPUT}{name}")
        density = _positive(value, f"the ambient force on {name}", f"{unit}/sqrt(Hz)")
        forces[name] = RandomForce(name, density, ambient=True, unit=unit)
    channels = _acting(record, structure) if input_noise else []
    if input_noise and not channels:
        raise IdentificationError(
            "no noise of an input can be estimated: the record has no applied force, and no motion of a base that the "
            "structure stands on; an ambient force needs no channel",
            arguments=("input_noise",),
        )
    for channel, value in _by_name(input_noise, channels).items():
        if channel not in channels:
            raise IdentificationError(
                f"no noise of {channel}{near_miss(channel, channels)} can be estimated: the inputs that act on the "
                f"structure are {', '.join(channels)}",
                arguments=("input_noise",),
            )
        name = channel.removeprefix(_INPUT)
        if name in forces:
            raise IdentificationError(
                f"noise of {channel} and an ambient force on {name} are the same to the mass: state one of them"
            )
        unit = unit_in(structure, channel)
        sigma = _positive(value, f"the noise of {channel}", unit)
        forces[name] = RandomForce(name, sigma, ambient=False, unit=unit)
        if channel not in record.forces:
            _require_white(channel, record, structure)
    return tuple(forces[name] for name in (*names, *_OF_BASE) if name in forces)


def with_noise_of_signals(
    records: Sequence[Record], input_noise: Stated, structure: Structure
) -> tuple[list[Record], Stated]:
    """The records with what is stated of the noise of signals in laws, which intervals allow for, and the rest of it.

    What is not stated is that which the records show. Raises IdentificationError for a deviation that is not positive.
    """
    signals = [f"signal:{name}" for name in structure.signals]
    stated = _by_name(input_noise, [*_acting(records[0], structure), *signals]) if signals else {}
    noise = {
        name: _positive(size, f"the noise of {name}", unit_in(structure, name))
        for name, size in stated.items()
        if name in signals
    }
    if not noise:
        return list(records), input_noise
    known = {name: size for name, size in noise.items() if size is not None}
    rest = {name: size for name, size in stated.items() if name not in noise}
    return [replace(record, noise={**record.noise, **known}) for record in records], rest


def noise_of_channels(records: Sequence[Record], structure: Structure) -> dict[str, float]:
    """Standard deviations of the noise of the inputs that act, in their SI units, as records state or show them.

    What a record shows is the floor of its spectrum beyond the band of the input, or where the input rests; an input that
    fills the band throughout shows none.
    """
    found: dict[str, float] = {}
    every = (f"signal:{name}" for name in structure.signals)
    # whose steps fill the band
    signals = (name for name in every if records[0].interpolation.get(name) != HELD)
    for channel in (*_acting(records[0], structure), *signals):
        powers = [_noise_power(record, channel) for record in records]
        if any(powers):
            found[channel] = float(np.sqrt(np.mean(powers)))
    return found


def _noise_power(record: Record, channel: str) -> float:
    """The variance of the noise of an input; 0 where nothing tells it from the input."""
    values = record.channel(channel)
    if not np.isfinite(values).all():
        return 0.0
    power = float(noise_deviations(record, [channel])[0]) ** 2
    size = float(np.mean(values**2))
    stated = channel in record.noise
    return power if stated or _ROUNDING**2 * size < power < NOISIEST_INPUT**2 * size else 0.0


def exciting_base(record: Record, structure: Structure) -> str | None:
    """The channel of the base by which it acts on the structure; None where it does not."""
    named = [f"{kind}:{BASE}" for kind in "xav" if f"{kind}:{BASE}" in record.inputs]
    acts = (
        any(BASE in link.between for link in structure.links)
        or framed(record, structure, integrated=True).acceleration is not None
    )
    return named[0] if named and acts else None


def _acting(record: Record, structure: Structure) -> list[str]:
    """The channels of applied forces, and that of the base where it acts."""
    return [*record.forces, *filter(None, [exciting_base(record, structure)])]


def _require_white(channel: str, record: Record, structure: Structure) -> None:
    """IdentificationError where noise of the base is not white in what it does to the masses and sensors."""
    free = [mass.name for mass in structure.masses if not mass.mass.known and np.isinf(mass.mass.sigma)]
    if (
        channel == f"a:{BASE}"
        and free
        and framed(record, structure, integrated=True).acceleration is not None
    ):
        raise IdentificationError(
            f'noise of {channel} cannot be allowed for beside the unknown mass "{free[0]}", on which its force is not known: '
            f"weigh it, or state {{ start, sigma }}, or give the displacement, x:{BASE}"
        )
    if channel == f"v:{BASE}":
        raise IdentificationError(
            f"noise of {channel} cannot be allowed for: what moves the masses is its derivative, in which each sample of "
            f"noise undoes the one before; give the acceleration, a:{BASE}, or the displacement, x:{BASE}"
        )
    rates = [channel for channel in record.motions if channel.relative and channel.order]
    if channel == f"x:{BASE}" and rates:
        raise IdentificationError(
            f"noise of {channel} cannot be allowed for beside {rates[0]}, to which its derivative is added: leave {channel} "
            f"out, and give the acceleration, a:{BASE}"
        )
    at_base = [link for link in structure.links if BASE in link.between]
    if channel == f"x:{BASE}" and at_base and not any("d" in symbols(link.law.elastic) for link in at_base):
        raise IdentificationError(
            f"noise of {channel} cannot be allowed for: no spring joins the base "
            f"({', '.join(link.name for link in at_base)}), and what moves the masses is its derivative, "
            f"which is not white; give the acceleration, a:{BASE}"
        )


def _by_name(given: Stated, names: Sequence[str]) -> dict[str, float | None]:
    """What is stated by name; `ALL` stands for each of the `names` that is not."""
    expect("ambient and input_noise", given, str, Mapping, tuple, list)
    stated = numbers_by_channel(given)
    every: dict[str, float | None] = dict.fromkeys(names, stated.pop(ALL)) if ALL in stated else {}
    return every | stated


def _positive(value: float | None, quantity: str, unit: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0.0 < value < np.inf:
        raise IdentificationError(
            f"{quantity} must be a positive number in {unit}, or None if it is to be found, got {value!r}"
        )
    return value


def refuse_beside_random_forces(
    errors: Sequence[Term], admitted: Sequence[str], *, robust: bool, records: Sequence[Record]
) -> None:
    """IdentificationError for what is not estimated, or not tested, beside random forces."""
    disturbed = [one.channel for one in errors if isinstance(one, Disturbance | HighPass)]
    of_links = [channel for record in records for channel in record.channels if channel.of_link]
    take_out = "find it in a record without such forces, and take it out (without_delays)"
    refused = (
        (late_beside_clocks(errors), "a delay of {}", take_out),
        (admitted, "errors of sensors to be admitted ({})", "name the channels (offsets, gains)"),
        (disturbed, "drift, hum or high pass of {}", "filter these channels"),
        (["loss"] * robust, "a robust loss", "mark outliers as missing (mark_missing)"),
        (of_links, "{}", "leave these channels out of the record"),
    )
    for given, description, instead in refused:
        if given:
            raise IdentificationError(
                f"random forces and {description.format(', '.join(given))} cannot be estimated together yet: {instead}"
            )


def with_random_forces(structure: Structure, places: Sequence[str]) -> Structure:
    """The structure with a link to the ground that carries each of the random forces; last among its links.

    `places` are masses, and channels of the base, whose link `system_with` makes one of all masses.
    """
    if not places:
        return structure
    still = dict.fromkeys(_HELD_STATE.coefficients, 0.0)
    link_names = {link.name for link in structure.links}
    links = []
    for place in places:
        name = f"random_{place.replace(':', '_')}"
        while name in link_names:
            name += "_"
        mass = structure.places[0] if place in _OF_BASE else place
        links.append(Link(name, (mass, GROUND), _HELD_STATE, still))
    return replace(structure, links=(*structure.links, *links))


def system_with(structure: Structure, places: Sequence[str], step: float) -> System:
    """The system of `with_random_forces` for samples a `step` in s apart; an error of the acceleration of the base acts on all
    masses, in m/s^2.
    """
    system = System.of(with_random_forces(structure, places), lag=LAG * step)
    incidence = system.incidence.copy()
    error = None
    for number, place in enumerate(places, start=len(structure.links)):
        if place in _OF_BASE:
            state = next(i for i, (link, _) in enumerate(system.states) if link == number)
            moved = place == f"a:{BASE}"
            incidence[:, system.state_links[state]] = system.parameters.stated_masses if moved else 0.0
            error = error if moved else state
    return replace(system, incidence=incidence, base_error=error)


def shown_directly(forces: Sequence[RandomForce], frame: FramedRecord) -> Floats | None:
    """(C, r) what the channels of a record show of the random forces beside the motion; None for nothing."""
    shown = np.zeros((len(frame.names), len(forces)))
    carrying = np.array([name in frame.carried for name in frame.names.values()])
    for number, force in enumerate(forces):
        if force.of_base:
            shown[carrying, number] = -1.0 if force.place == f"a:{BASE}" else 1.0
    return shown if shown.any() else None


def force_estimates(
    forces: Sequence[RandomForce], deviations: Floats, rate: float
) -> tuple[RandomForceEstimate, ...]:
    """The forces with their `deviations` (r,) in N of samples at `rate`; zero of those that were not found."""
    densities = deviations * np.sqrt(2.0 / rate)
    return tuple(
        RandomForceEstimate(
            force.where, force.ambient, size, density, found=force.deviation is None, unit=force.unit
        )
        for force, size, density in zip(forces, deviations.tolist(), densities.tolist(), strict=True)
    )


def first_deviations(
    forces: Sequence[RandomForce], frame: FramedRecord, structure: Structure, velocities: Floats
) -> Floats:
    """(r,) standard deviations of samples in their units: those stated, else where a search starts.

    `velocities` (n, N) are those of the masses in the record of the `frame`.
    """
    record = frame.record
    out = []
    for force in forces:
        if force.deviation is not None:
            deviation = force.deviation * float(np.sqrt(record.rate / 2.0) if force.ambient else 1.0)
        elif force.ambient:
            index = structure.mass_names.index(force.place)
            inertia = structure.mass_values[index] * np.gradient(velocities[index], record.step)
            deviation = _FIRST_GUESS * float(np.sqrt(np.mean(inertia**2)))
        else:
            moved = force.place == f"a:{BASE}"
            applied = frame.acceleration if moved else record.channel(force.where)
            assert applied is not None
            deviation = _FIRST_NOISE * float(np.sqrt(np.mean(applied**2)))
        out.append(max(deviation, float(np.finfo(float).tiny) ** 0.25))
    return np.array(out)
