"""Random forces that no channel shows, or shows with noise: which masses they act on, and the structure with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.random_force import RandomForceEstimate
from linkwise.model.coefficient import Coefficient
from linkwise.model.law import Law
from linkwise.model.link import GROUND, Link
from linkwise.model.link_state import LinkState
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.text import near_miss

ALL = "all"
_INPUT = "force:"
_FIRST_GUESS = (
    0.3  # of the force of inertia, by root mean square: where the search for an ambient force starts
)
_FIRST_NOISE = 0.01  # of a force channel: where the search for its noise starts
_HELD_STATE = Law.parse("-z", {"z": LinkState("0*rate*z", unit="N")})
"""Law of a link to the ground that carries a force; the force is constant within a segment."""

Deviations: TypeAlias = Mapping[str, float | None] | Sequence[str]


@dataclass(frozen=True)
class RandomForce:
    """A white random force on a mass.

    Attributes
    ----------
    mass : str
        The mass.
    deviation : float or None
        Of the noise of a channel of the applied force the standard deviation of a sample in N, of an ambient force its
        one-sided amplitude spectral density in N/sqrt(Hz); None if it is to be found.
    ambient : bool
        Whether it is an ambient force.
    """

    mass: str
    deviation: float | None
    ambient: bool

    def of_samples(self, rate: float) -> float:
        """Standard deviation in N of samples at `rate`, NaN where it is to be found."""
        if self.deviation is None:
            return float("nan")
        return self.deviation * float(np.sqrt(rate / 2.0)) if self.ambient else self.deviation


def random_forces(
    ambient: Deviations, input_noise: Deviations, record: Record, structure: Structure
) -> tuple[RandomForce, ...]:
    """The random forces that a user states, in the order of the masses.

    Raises IdentificationError for an unknown mass or channel, a deviation that is not positive, and a mass named in both.
    """
    names = structure.places
    if structure.hosts and (ambient or input_noise):
        raise IdentificationError(
            "random forces on hosts are not supported: leave the ambient forces and input noise out"
        )
    forces = {}
    for name, value in _each(ambient, names).items():
        if name not in names:
            raise IdentificationError(
                f"no ambient force can act on {name}{near_miss(name, names)}: the masses are {', '.join(names)}; "
                f'"{ALL}" stands for each of them'
            )
        forces[name] = RandomForce(name, _positive(value, f"the ambient force on {name}", "N/sqrt(Hz)"), True)
    channels = [channel for channel in record.inputs if channel.startswith(_INPUT)]
    if input_noise and not channels:
        raise IdentificationError(
            "no noise of an applied force can be estimated: the record has no applied force; an ambient force needs no channel"
        )
    for channel, value in _each(input_noise, channels).items():
        if channel not in channels:
            raise IdentificationError(
                f"no noise of {channel}{near_miss(channel, channels)} can be estimated: the applied forces in the record are "
                f"{', '.join(channels)}"
            )
        name = channel.removeprefix(_INPUT)
        if name in forces:
            raise IdentificationError(
                f"noise of {channel} and an ambient force on {name} are the same to the mass: state one of them"
            )
        forces[name] = RandomForce(name, _positive(value, f"the noise of {channel}", "N"), False)
    return tuple(forces[name] for name in names if name in forces)


def _each(given: Deviations, names: Sequence[str]) -> dict[str, float | None]:
    if isinstance(given, str):
        given = (given,)
    if not isinstance(given, Mapping | Sequence):
        raise IdentificationError(
            f'random forces are stated by name, as in ["m1"] or {{"m1": 0.5}}, or as "{ALL}"; got {given!r}'
        )
    stated = dict(given) if isinstance(given, Mapping) else dict.fromkeys(given, None)
    if ALL not in stated:
        return stated
    every = stated.pop(ALL)
    return dict.fromkeys(names, every) | stated


def _positive(value: float | None, what: str, unit: str) -> float | None:
    if value is None:
        return None
    if isinstance(value, bool) or not isinstance(value, int | float | np.number) or not 0.0 < value < np.inf:
        raise IdentificationError(
            f"{what} must be a positive number in {unit}, or None if it is to be found, got {value!r}"
        )
    return value


def refuse_beside_random_forces(
    delays: Sequence[str],
    admitted: Sequence[str],
    disturbed: Sequence[str],
    *,
    robust: bool,
    records: Sequence[Record],
) -> None:
    """IdentificationError for what is not estimated, or not tested, beside random forces."""
    of_links = [name for record in records for name in record.channels if name.startswith(("f:", "state:"))]
    refused = (
        (
            delays,
            f"a delay of {', '.join(delays)}",
            "find it in a record without such forces, and take it out (without_delays)",
        ),
        (
            admitted,
            f"errors of sensors to be admitted ({', '.join(admitted)})",
            "name the channels (offsets, gains)",
        ),
        (disturbed, f"drift or hum of {', '.join(disturbed)}", "filter these channels"),
        (robust, "a robust loss", "mark outliers as missing (mark_missing)"),
        (of_links, ", ".join(of_links), "leave these channels out of the record"),
    )
    for given, what, instead in refused:
        if given:
            raise IdentificationError(f"random forces and {what} cannot be found together yet: {instead}")


def with_random_forces(structure: Structure, masses: Sequence[str]) -> Structure:
    """The structure with a link to the ground that carries the random force of each of the `masses`; last among its links."""
    if not masses:
        return structure
    still = {name: Coefficient.number(0.0) for name in _HELD_STATE.coefficients}
    taken = {link.name for link in structure.links}
    links = []
    for mass in masses:
        name = f"random_{mass}"
        while name in taken:
            name += "_"
        links.append(Link(name, (mass, GROUND), _HELD_STATE, still))
    return replace(structure, links=(*structure.links, *links))


def force_estimates(
    forces: Sequence[RandomForce], deviations: Floats, rate: float
) -> tuple[RandomForceEstimate, ...]:
    """The forces with their `deviations` (r,) in N of samples at `rate`."""
    density = deviations * np.sqrt(2.0 / rate)
    return tuple(
        RandomForceEstimate(
            where=force.mass if force.ambient else f"{_INPUT}{force.mass}",
            ambient=force.ambient,
            deviation=float(deviations[number]),
            spectral_density=float(density[number]),
            found=force.deviation is None,
        )
        for number, force in enumerate(forces)
    )


def first_deviations(
    forces: Sequence[RandomForce], record: Record, structure: Structure, velocities: Floats
) -> Floats:
    """(r,) standard deviations of samples in N: those stated, else where a search starts.

    `velocities` (n, N) are those of the masses in `record`.
    """
    out = []
    for force in forces:
        deviation = force.of_samples(record.rate)
        if np.isnan(deviation) and force.ambient:
            index = structure.mass_names.index(force.mass)
            inertia = structure.mass_values[index] * np.gradient(velocities[index], record.step)
            deviation = _FIRST_GUESS * float(np.sqrt(np.mean(inertia**2)))
        elif np.isnan(deviation):
            applied = record.channel(f"{_INPUT}{force.mass}")
            deviation = _FIRST_NOISE * float(np.sqrt(np.mean(applied**2)))
        out.append(max(deviation, float(np.finfo(float).tiny) ** 0.25))
    return np.array(out)
