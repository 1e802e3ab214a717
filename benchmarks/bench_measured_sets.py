"""Measured sets of other laboratories: grade, time, and what is left of a part that no coefficient was identified from.

    python benchmarks/bench_measured_sets.py [FOLDER] [--write docs/how-to/measured-sets.md]

prints a table in some minutes, and writes it into the page of the documentation between its markers; `--only emps wheel`
does so with some of its rows. The records are not part of linkwise: sets whose files are not in the folder ../shared/data are
left out, as are those of public repositories that do not stand as OWNER/NAME/PATH in FOLDER.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from time import process_time
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

import linkwise as lw

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
PUBLIC = DATA / "public"
BEGIN, END = "<!-- table of benchmarks/bench_measured_sets.py -->", "<!-- end of the table -->"


@dataclass(frozen=True)
class MeasuredSet:
    """A record, of which a first `part` identifies, the structure, and what others publish of the rest.

    Where other records of the structure, by name, are `held` back, all of the record identifies; `unscored` seconds of them
    determine their states. A structure that is identified already, as a host of linear modes, only predicts.
    """

    name: str
    record: lw.Record
    structure: lw.Structure
    published: str
    part: float = 0.6
    options: Mapping[str, Any] = field(default_factory=dict)
    held: Mapping[str, lw.Record] = field(default_factory=dict)
    unscored: float | None = None


def emps() -> MeasuredSet:
    """A servo axis: mass and friction from the force of the motor; sign(v), which its authors take, sticks where it stands."""
    file = loadmat(DATA / "emps.mat")
    values = np.column_stack([file["qm"].ravel(), (file["vir"] * file["gtau"]).ravel()])
    axis = lw.rig({"car": "unknown"}, {"axis": "car - ground: fv*v + fc*tanh(v/0.001) + off"})
    published = "mass 95.1 kg, 203.5 N s/m, 20.4 N (its authors, by least squares)"
    return MeasuredSet("EMPS", lw.Record(0.0, 1000.0, ("x:car", "force:car"), values), axis, published)


def silverbox() -> MeasuredSet:
    """A circuit that behaves as a Duffing oscillator."""
    law = "k*d + k2*d**2 + k3*d**3 + k4*d**4 + k5*d**5 + c*v + c1*v*d + c2*v*d**2 + f0"
    box = lw.rig({"m1": "unknown"}, {"spring": f"m1 - ground: {law}"})
    return MeasuredSet(
        "Silverbox",
        lw.read_record(DATA / "silverbox_multisine.csv"),
        box,
        "0.26 mV of 54 (37 parameters)",
        0.8,
    )


def bouc_wen() -> MeasuredSet:
    """The Bouc-Wen benchmark: hysteresis, with the noise of its authors."""
    with h5py.File(DATA / "bouc_wen_train.h5") as file:
        columns = [np.ravel(file[f"multisine/{name}"][:]) for name in ("y", "u")]
    joint = lw.model.named_law("bouc-wen-classical").link("joint", ("m1", "ground"))
    structure = lw.Structure("", (lw.Mass("m1", lw.Coefficient.unknown()),), (joint,))
    record = lw.Record(0.0, 750.0, ("x:m1", "force:m1"), np.column_stack(columns))
    return MeasuredSet(
        "Bouc-Wen", record, structure, "19 um (polynomial state space), its noise is 7.4 um", 0.8
    )


def storey() -> MeasuredSet:
    """A model building of one storey on a shake table, two wireless sensors."""
    folder, stamps = DATA / "shake_table", {"time[us]": "SampleTimeFine"}
    floor = lw.read_record(folder / "stiff1_top_elcentro.csv", channels={**stamps, "a:floor": "Acc_X"})
    base = lw.read_record(folder / "stiff1_ground_elcentro.csv", channels={**stamps, "a:base": "Acc_X"})
    frame = lw.rig({"floor": 1.0}, {"frame": "floor - base: k*d + c*v"})
    options = {"offsets": ["a:floor"], "delays": ["a:floor"]}
    return MeasuredSet("shake table", lw.records.beside(floor, base), frame, "none", options=options)


def magnet_beam() -> MeasuredSet:
    """The decay of a beam whose tip magnet moves between magnets, by its strain."""
    law = "k*d + k2*d**2 + k3*d**3 + c*v + c1*v*d + c2*v*d**2"
    beam = lw.rig({"m1": 1.0}, {"beam": f"m1 - ground: {law}"})
    record = lw.read_record(DATA / "magnet_beam_decay.csv")
    return MeasuredSet("magnet beam", record, beam, "none for a free run", options={"offsets": ["x:m1"]})


def mr_damper() -> MeasuredSet:
    """A magnetorheological damper without current, its motion prescribed."""
    law = lw.Law.parse("k*d + c*v + q + F*tanh(v/v0)", {"q": "sigma*(v - abs(v)*q/Fc)"})
    unknown = {
        name: lw.Coefficient.unknown(lower=0.0 if name in ("v0", "sigma", "Fc") else -np.inf)
        for name in law.coefficients
    }
    rig = lw.Structure("", (), (lw.Link("damper", ("base", "ground"), law, unknown),))
    record = lw.read_record(
        DATA / "mr_damper" / "data_simulation_4.1_MRdamper.mat",
        channels={"x:base[mm]": "x_F(:,1)", "f:damper": "x_F(:,3)"},
        rate=100.0,
    )
    return MeasuredSet("MR damper", record, rig, "none", options={"offsets": ["f:damper"]})


def friction_damper() -> MeasuredSet:
    """A rotary friction damper with backlash."""
    rig = lw.Structure("", (), (lw.model.named_law("band-brake").link("damper", ("base", "ground")),))
    channels = {"time": "data(:,1)", "x:base[in]": "data(:,2)", "f:damper[kip]": "data(:,3)"}
    record = lw.read_record(DATA / "friction_damper" / "d2_0.5Hz_36lb_1in.json", channels=channels)
    return MeasuredSet("friction damper", record, rig, "none", options={"offsets": ["f:damper"]})


AIRCRAFT = "AronssonAlfred/SSY230_Master/Project_3/BenchmarkData/F16Data_FullMSine_Level{}.mat"
PLACES = {"force:ac.exc": "Force", "a:ac.exc": "Acceleration(:,1)", "a:ac.wing": "Acceleration(:,2)"}
PERIOD = 20.48  # s, of the multisine
UNSCORED = 10.0  # s, in which states are estimated


def level(number: int) -> lw.Record:
    """A ground vibration test of an F-16 at one of seven levels: a shaker and three accelerometers, nine periods."""
    channels = {**PLACES, "a:ac.pay": "Acceleration(:,3)"}
    return lw.read_record(PUBLIC / AIRCRAFT.format(number), channels=channels, rate=400.0)


def predicted_levels() -> dict[str, lw.Record]:
    """The last period of levels that nothing was identified from, after 10 s that are not scored."""
    return {
        f"level {number}": (record := level(number).decimate(4))[-round((PERIOD + UNSCORED) * record.rate) :]
        for number in (3, 7)
    }


def aircraft_linear() -> MeasuredSet:
    """The modes of level 5, the best linear model of it."""
    host = lw.modal.identify_host(level(5)).host
    structure = lw.Structure("F-16", (), (), hosts=(host,))
    structure = structure.with_values({p.name: p.start for p in structure.parameters if p.start is not None})
    return MeasuredSet("F-16, linear", level(5), structure, "", held=predicted_levels(), unscored=UNSCORED)


def aircraft() -> MeasuredSet:
    """A host from level 1, and from level 5 what softens and damps it between the wing and the ground."""
    host = lw.modal.identify_host(level(1)).host
    law = lw.Law.parse("k*d + c*v + F*z", {"z": "(v - 0.5*abs(v)*z - 0.5*v*abs(z))/x0"})
    starts = {
        "k": lw.Coefficient.unknown(-15e3),
        "c": lw.Coefficient.unknown(0.0),
        "F": lw.Coefficient.unknown(7.5, lower=0.0),
        "x0": lw.Coefficient.unknown(5e-4, lower=2e-5, upper=2e-2),
    }
    joint = lw.Link("joint", ("ac.wing", "ground"), law, starts)
    return MeasuredSet(
        "F-16",
        lw.records.average_periods(level(5).decimate(4), PERIOD),
        lw.Structure("F-16", (), (joint,), hosts=(host,)),
        "none for hosts with one joint",
        options={"as_stated": True},
        held=predicted_levels(),
        unscored=UNSCORED,
    )


def harvester() -> MeasuredSet:
    """A bistable harvester in one of its wells; its records end at 25 Hz, below most of what a jump between wells shows."""
    folder = (
        "americocunhajr/BistableX/DataExperimental/base_rotation_phi=0/single_freq/freq_9.1Hz/mag_vr=0_vl=0"
    )
    time, base, _, _, _, tip = np.loadtxt(PUBLIC / folder / "amplitude_50mV.csv", delimiter=",").T
    beam = lw.rig({"tip": 1.0}, {"beam": "tip - base: k*d + k2*d**2 + k3*d**3 + c*v"})
    record = relative_to_base(9.81 * base, tip, 1.0 / time[1]).between(14.0, 30.0)
    return MeasuredSet("BistableX", record, beam, "none for a free run", 0.75)


def relative_to_base(base: np.ndarray, tip: np.ndarray, rate: float) -> lw.Record:
    """The velocity of a tip (N,) beside that of its base, from the acceleration (N,) of that."""
    spectrum, frequency = np.fft.rfft(base), np.fft.rfftfreq(len(base), 1.0 / rate)
    moved = frequency > 1.0  # Hz, above which the acceleration of the base is no drift
    velocity = np.fft.irfft(
        np.where(moved, spectrum / (2j * np.pi * np.maximum(frequency, 1.0)), 0.0), len(base)
    )
    return lw.Record(0.0, rate, ("a:base", "rel:v:tip"), np.column_stack([base, tip - velocity]))


def chaos_of_harvester() -> np.ndarray:
    """Base in m/s^2, tip in m/s by laser at 0.1 m/s per V, and voltage of the same harvester (N, 3), at 2048 Hz."""
    folder = PUBLIC / "americocunhajr/BistableX/DataExperimental/poincare_analysis/chaos_symmetric"
    file = loadmat(folder / "DPsv00000.mat")
    return np.column_stack([9.81 * file["X1"][:, 1], 0.1 * file["X3"][:, 1], file["X2"][:, 1]])


def harvester_between_wells() -> MeasuredSet:
    """The same harvester as it jumps between its wells: 4 s."""
    base, tip, _ = chaos_of_harvester().T
    record = relative_to_base(base, tip, 2048.0).decimate(8)
    beam = lw.rig({"tip": 1.0}, {"harvester": "tip - base: alpha*d + beta*d**3 + gamma*d**5 + c*v"})
    return MeasuredSet("BistableX, both wells", record, beam, "none for a free run", 0.9)


def harvester_with_voltage() -> MeasuredSet:
    """The same with the voltage of its patch on 1 MOhm in the law."""
    base, tip, voltage = chaos_of_harvester().T
    bare = relative_to_base(base, tip, 2048.0)
    channels, values = (*bare.channels, "state:harvester.V"), np.column_stack([bare.values, voltage])
    circuit = lw.model.LinkState("(theta*v - V/R)/C", unit="V")
    law = lw.Law.parse("alpha*d + beta*d**3 + gamma*d**5 + c*v - theta*V", {"V": circuit})
    known = {"C": lw.Coefficient.unknown(lower=0.0), "R": lw.Coefficient.number(1e6)}
    values_of = {name: known.get(name, lw.Coefficient.unknown()) for name in law.coefficients}
    link = lw.Link("harvester", ("tip", "base"), law, values_of)
    beam = lw.Structure("", (lw.Mass("tip", lw.Coefficient.number(1.0)),), (link,))
    record = lw.Record(0.0, 2048.0, channels, values).decimate(8)
    options = {"as_stated": True}
    return MeasuredSet(
        "BistableX, with its voltage", record, beam, "none for a free run", 0.9, options=options
    )


STUDENTS = {"x:frame[mm]": "sensor2", "x:damper[mm]": "sensor1"}


def decay(example: str, number: int, channel: str, unit: float = 1.0) -> lw.Record:
    """One of the free decays of one channel that an example of spectral submanifolds learns from."""
    time, motion, *_ = loadmat(PUBLIC / "haller-group/SSMLearn/examples" / example)["xData"][number]
    rate = 1.0 / round(float(np.diff(time.ravel()).mean()), 9)
    return lw.Record(0.0, rate, (channel,), unit * motion.T)


def sloshing() -> MeasuredSet:
    """Water in a tank, whose motor lets go: the centre of its mass hardens less the higher it sloshes."""
    law = "k*d + k3*d**3 + k5*d**5 + c*v + c2*v*d**2"
    first, second = (decay("sloshing/data/xData.mat", number, "x:water", 1e-3) for number in (0, 1))
    held = {"another decay": second}
    tank = lw.rig({"water": 1.0}, {"surface": f"water - ground: {law}"})
    return MeasuredSet("sloshing tank", first, tank, "none for a free run", held=held)


def double_beam() -> MeasuredSet:
    """A beam in a frame, hit by a hammer, its two modes an octave apart: by the velocity of its tip alone."""
    law = "k*d + k3*d**3 + c*v + c2*v*d**2"
    first, second = (
        decay("resonantdoublebeam/data.mat", number, "v:tip").between(0.0, 0.5) for number in (0, 1)
    )
    starts = {
        "frame.k": 3.2e6,
        "frame.c": 10.0,
        "joint.k": 1.7e6,
        "joint.c": 5.0,
        "joint.k3": 0.0,
        "joint.c2": 0.0,
    }
    beams = lw.rig(
        {"tip": 1.0, "frame": 4.0},
        {"frame": "frame - ground: k*d + c*v", "joint": f"tip - frame: {law}"},
        known={name: {"start": start} for name, start in starts.items()},
    )
    return MeasuredSet("double beam", first, beams, "none for a free run", held={"another hit": second})


def jointed_beam() -> MeasuredSet:
    """Two halves of a beam in a lap joint, after a hit: the first mode, which softens and loses more where it moves more."""
    [[file]] = loadmat(PUBLIC / "mattiacenedese/BRBtesting/HammerImpact.mat")["HIdata"]
    record = lw.Record(0.0, 12800.0, ("a:beam",), np.asarray(file[3]).T).decimate(32)  # below the second mode
    beam = lw.rig({"beam": 1.0}, {"joint": "beam - ground: k*d + k2*d*abs(d) + c*v + c2*v*abs(d)"})
    options = {"offsets": ["a:beam"]}
    return MeasuredSet(
        "Brake-Reuss beam", record.between(0.5, 5.0), beam, "none for a free run", options=options
    )


def pendulum() -> MeasuredSet:
    """A pendulum of a remote laboratory, let go by its coil: degrees of an encoder, and friction that ends it."""
    swing = lw.rig({"bob": "1 kg m^2"}, {"pivot": "bob - ground: k*sin(d) + c*v + F*tanh(v/0.05)"})
    path = PUBLIC / "timdrysdale/pendulum-data/data/pend00-run05.csv"
    record = lw.read_record(path, channels={"time": "Time/s", "x:bob[rad]": "Angle/rad"}, resample=20.0)
    return MeasuredSet("pendulum", record.between(6.5, 24.0), swing, "none")


def students_damper() -> MeasuredSet:
    """A tuned mass damper on a frame, by two distance sensors of whole millimetres that are read one after the other."""
    frame = lw.rig(
        {"frame": 1.0, "damper": "unknown"},
        {"frame": "frame - ground: k*d + c*v", "damper": "damper - frame: k*d + c*v"},
    )
    path = PUBLIC / "joshniemela/TunedMassDamper/dataCollection/resultingData.csv"
    record = lw.read_record(path, channels={"time": "Time", **STUDENTS}, resample=32.0)
    options = {"offsets": ["x:frame", "x:damper"], "delays": ["x:frame"]}
    return MeasuredSet("tuned mass damper", record.between(10.2, 17.3), frame, "none", options=options)


def wheel() -> MeasuredSet:
    """A bicycle wheel that turns on a steel rod of known stiffness, by a gyroscope: its moment of inertia."""
    stiffness = 77e9 * np.pi * 6.35e-3**4 / 32.0 / 1.05  # N m/rad: a rod of 6.35 mm and 1.05 m
    rod = lw.Link(
        "rod",
        ("wheel", "ground"),
        lw.Law.parse("k*d + c*v"),
        {"k": lw.Coefficient.number(stiffness), "c": lw.Coefficient.unknown()},
    )
    structure = lw.Structure("", (lw.Mass("wheel", lw.Coefficient.unknown(), "rad"),), (rod,))
    path = PUBLIC / "moorepants/resonance/notebooks/03/bicycle-wheel-radial-inertia-rate-gyro-measurement.csv"
    record = lw.read_record(path, channels={"v:wheel[rad/s]": "angular_velocity"})
    return MeasuredSet("bicycle wheel", record, structure, "none", options={"offsets": ["v:wheel"]})


SETS: tuple[Callable[[], MeasuredSet], ...] = (
    emps,
    silverbox,
    bouc_wen,
    storey,
    magnet_beam,
    mr_damper,
    friction_damper,
    harvester,
    harvester_between_wells,
    harvester_with_voltage,
    sloshing,
    double_beam,
    jointed_beam,
    pendulum,
    students_damper,
    wheel,
    aircraft_linear,
    aircraft,
)


def left_of(record: lw.Record, model: lw.Estimate | lw.Structure, burn: float | None = None) -> str:
    """What a prediction leaves of each channel by root mean squares, and in per cent of it; or why there is none."""
    try:
        channels = lw.validate(record, model, burn=burn).channels
    except lw.LinkwiseError as error:
        return str(error).partition(";")[0]
    return ", ".join(
        f"{channel}: {scores.rmse:.3g} {scores.unit} ({scores.nmse_percent**0.5 * 10.0:.2g} %)"
        for channel, scores in channels.items()
    )


def row(measured: MeasuredSet) -> tuple[str, ...]:
    """What is asked, the grade, the processor time, and what is left of the rest by root mean squares."""
    record, structure = measured.record, measured.structure
    split = len(record) if measured.held else round(measured.part * len(record))
    found, started = None, process_time()
    if structure.parameters:
        found = lw.identify(record[:split], structure, **measured.options)
    seconds = process_time() - started
    law = (
        "; ".join(link.law.text for link in structure.links if link.name not in structure.modes)
        or "linear modes"
    )
    model, grade = (structure, "") if found is None else (found, found.grade.value)
    held = {name: left_of(rest, model, measured.unscored) for name, rest in measured.held.items()}
    left = "; ".join(f"{name}: {told}" for name, told in held.items()) or left_of(record[split:], model)
    return measured.name, f"`{law}`", grade, f"{seconds:.0f}", left, measured.published


def rows(only: Sequence[str] = ()) -> Iterator[tuple[str, ...]]:
    """The title and a row for each set that is there, or of those of some names."""
    yield "set", "law", "grade", "CPU-s", "left of what was held back", "best published"
    for make in SETS:
        if only and make.__name__ not in only:
            continue
        try:
            measured = make()
        except (OSError, lw.RecordError):
            print(f"no {make.__name__} beside the checkout")
            continue
        yield row(measured)


def main() -> None:
    """Print the table, and write it into a page."""
    global PUBLIC
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", nargs="?", type=Path, default=PUBLIC)
    parser.add_argument("--write", type=Path)
    parser.add_argument("--only", nargs="*", default=[])
    asked = parser.parse_args()
    PUBLIC = asked.folder
    lines = []
    for number, cells in enumerate(rows(asked.only)):
        lines += [f"| {' | '.join(cells)} |", *["|---" * len(cells) + "|"] * (number == 0)]
        print(lines[-1] if number else "\n".join(lines), flush=True)
        if asked.write:
            write(asked.write, lines, keep=bool(asked.only))


def write(page: Path, lines: Sequence[str], *, keep: bool) -> None:
    """Write the lines of a table between the markers of a page, in place of its rows of the same sets, or of all."""
    before, _, rest = page.read_text().partition(BEGIN)
    there, _, behind = rest.partition(END)
    kept = [line for line in there.splitlines() if line.startswith("|")] if keep else []
    of_sets = {line.split(" | ")[0]: line for line in (*kept, *lines)}
    page.write_text("\n".join([f"{before}{BEGIN}", "", *of_sets.values(), "", f"{END}{behind}"]))


if __name__ == "__main__":
    main()
