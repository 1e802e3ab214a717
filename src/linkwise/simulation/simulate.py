"""From a structure and an excitation to the record that sensors would measure."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.errors import RecordError, SimulationError
from linkwise.model.excitation import Excitation, Impulse
from linkwise.model.input_signal import InputSignal
from linkwise.model.link import BASE
from linkwise.model.structure import Structure
from linkwise.progress import Progress, silent
from linkwise.records.channel import Channel
from linkwise.records.channel_units import in_units_of
from linkwise.records.record import Record
from linkwise.records.truth import SimulationTruth
from linkwise.simulation.checks import check_excitation, check_link, check_mass, check_state, output_times
from linkwise.simulation.link_forces import LinkForces
from linkwise.simulation.motion import SimulatedMotion
from linkwise.simulation.rig import RigDiagnostics, with_mass_at_rest
from linkwise.simulation.schedule import RunSchedule

_KINDS = ("x", "v", "a")  # each the derivative of the one before


class ExcitationKeywords(TypedDict, total=False):
    """The keywords of `Excitation.of`."""

    release: Mapping[str, float]
    impulses: Iterable[Impulse]
    forces: Mapping[str, InputSignal | str | float]
    base: InputSignal | str | float | None


@checked
def simulate(
    structure: Structure,
    *,
    duration: float | None = None,
    rate: float | None = None,
    times: ArrayLike | None = None,
    sensors: Iterable[str] = ("x",),
    progress: Progress = silent,
    **excitation: Unpack[ExcitationKeywords],
) -> Record:
    """Simulate a structure from t = 0 and return what sensors measure.

    The motion is integrated by a Taylor method to rounding precision.

    Parameters
    ----------
    structure : Structure
        A structure whose masses and coefficients have values.
    duration : float, optional
        Time in s to simulate.
    rate : float, optional
        Sampling rate in Hz.
    times : array of shape (N,), optional
        Output times in s instead of duration and rate, evenly spaced and not negative.
    sensors : iterable of str, optional
        Kinds of sensors on every mass (``"x"``, ``"v"``, ``"a"``; ``"rel:x"`` relative to the base), on every link (``"f"``,
        its force; of links alone on a rig the default) or in every state of a link (``"state"``), or channels (``"a:m2"``,
        ``"f:spring"``, ``"state:piezo.V"``).
        Forces are always recorded, and the displacement of the base, unless its velocity or acceleration is named
        (``"a:base"``).
    progress : Progress, optional
        Called with a `ProgressReport` while the simulation runs.
    **excitation
        What drives the structure, as in `Excitation`: `release`, ``{"x:m1": m, "v:m1": m/s}``, where ``"state:piezo.V"`` takes
        the place of the initial value of a state; `impulses`, a sequence of
        `Impulse`; `forces`, for each mass an expression of t in N or `Sampled`; `base`, its displacement in m, likewise.

    Returns
    -------
    Record
        The channels without noise; `Record.simulated` has the motion of all masses, energies and the predictability horizon.

    Raises
    ------
    SimulationError
        If an argument is not valid, or the motion diverges; the error has time and mass.
    StructureError
        If a mass or coefficient has no value.
    TypeError
        If `structure` is no `Structure`.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=["x", "a:m2"])
    Record of 1001 samples at 1000 Hz, 0 to 1 s: x:m1, x:m2, a:m2
    """
    grid = output_times(duration, rate, times)
    drive = Excitation.of(**excitation)
    check_excitation(structure, drive, float(grid[-1]))
    channels = _channels(structure, drive, sensors)
    moved = with_mass_at_rest(structure)
    motion = SimulatedMotion.of(RunSchedule(moved, drive, grid), progress)
    values = np.empty((len(grid), len(channels)))
    states = {
        f"{structure.links[number].name}.{name}": motion.states[:, column]
        for column, (number, name) in enumerate(structure.topology.states)
    }
    arrays = {"x": motion.displacement, "v": motion.velocity, **_derived(moved, drive, motion, channels)}
    for column, channel in enumerate(channels):
        order = _KINDS.index(channel.kind) if channel.kind in _KINDS else 0
        if channel.is_input:
            signal = drive.drives[channel.mass]
            values[:, column] = signal.derivative(grid, order) if order else signal.value(grid)
        elif channel.kind == "state":
            values[:, column] = states[channel.mass]
        elif channel.kind == "f":
            values[:, column] = arrays["f"][:, structure.links.index(structure.link(channel.mass))]
        else:
            values[:, column] = arrays[channel.kind] @ structure.topology.row(channel.mass)
        if channel.relative:
            signal = drive.drives[BASE]
            values[:, column] -= signal.derivative(grid, order) if order else signal.value(grid)
    base = None if drive.base is None else drive.base.value(grid)
    record = Record(
        start=float(grid[0]),
        rate=float(rate) if rate is not None else (len(grid) - 1) / float(grid[-1] - grid[0]),
        channels=tuple(str(channel) for channel in channels),
        values=values,
        simulated=SimulationTruth(
            structure,
            motion.displacement[:, : structure.size],
            motion.velocity[:, : structure.size],
            base,
            RigDiagnostics(motion) if structure.on_rig else motion,
            states=states,
        ),
        source=f"simulation of {structure.name}",
    )
    return in_units_of(record, structure)


def _derived(
    structure: Structure, drive: Excitation, motion: SimulatedMotion, channels: Iterable[Channel]
) -> dict[str, Floats]:
    """Accelerations (N, n) in m/s^2 and forces in links (N, L) in N, where a channel shows them."""
    kinds = {channel.kind for channel in channels}
    forces, time = LinkForces(structure, drive), motion.schedule.times
    x, v, states = motion.displacement, motion.velocity, motion.states
    derived = {}
    if "a" in kinds:
        derived["a"] = forces.accelerations(time, x, v, states)
    if "f" in kinds:
        derived["f"] = forces.links(*forces.elongations(time, x, v), states)
    return derived


def _channels(structure: Structure, excitation: Excitation, sensors: Iterable[str]) -> list[Channel]:
    """Responses in the order of `sensors`, then the inputs."""
    wanted = sensors.split() if isinstance(sensors, str) else list(sensors)
    if structure.on_rig and wanted == ["x"]:
        wanted = ["f"]
    if not wanted:
        raise SimulationError(
            'sensors must have at least one kind, "x", "v" or "a", or "f" or "state" of links, or channel, such as "a:m1"'
        )
    repeated = next((name for i, name in enumerate(wanted) if name in wanted[:i]), None)
    if repeated is not None:
        raise SimulationError(f"the sensor {repeated} is listed twice", arguments=("sensors",))
    responses: dict[Channel, None] = {}
    of_base: dict[Channel, None] = {}
    for name in wanted:
        kind = name.removeprefix("rel:")
        if kind in _KINDS:
            relative = kind != name
            _require_moving_base(excitation, name, relative)
            responses.update(dict.fromkeys(Channel(kind, mass, relative) for mass in structure.places))
            continue
        if name == "f":
            responses.update(dict.fromkeys(Channel(name, link.name) for link in structure.links))
            continue
        if name == "state":
            owned = ((structure.links[number].name, state) for number, state in structure.topology.states)
            responses.update(dict.fromkeys(Channel(name, f"{link}.{state}") for link, state in owned))
            continue
        try:
            channel = Channel.parse(name)
        except RecordError as error:
            raise SimulationError(f"invalid sensor: {error}") from None
        _require_moving_base(excitation, name, channel.relative or channel.mass == BASE)
        if channel.mass == BASE:
            of_base[channel] = None
            continue
        if channel.is_input:
            raise SimulationError(f"{name} is an input, which is recorded whenever it drives the structure")
        if channel.kind == "f":
            check_link(channel.mass, structure, "a sensor")
        elif channel.kind == "state":
            check_state(channel.mass, structure, "a sensor")
        else:
            check_mass(channel.mass, structure, "a sensor")
        responses[channel] = None
    inputs: list[Channel] = []
    for name in excitation.drives:
        inputs += (of_base or (Channel("x", BASE),)) if name == BASE else (Channel("force", name),)
    return [*responses, *inputs]


def _require_moving_base(excitation: Excitation, sensor: str, needed: bool) -> None:
    if needed and excitation.base is None:
        raise SimulationError(f"sensor {sensor} needs a base that moves: give its displacement (`base`)")
