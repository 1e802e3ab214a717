"""Measured sets of other laboratories: grade, time, and what is left of a part that no coefficient was identified from.

    python benchmarks/bench_measured_sets.py

prints a table in some minutes. The records are not part of linkwise: sets whose files are not in the folder ../shared/data are
left out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from time import perf_counter
from typing import Any

import h5py
import numpy as np
from scipy.io import loadmat

import linkwise as lw

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"


@dataclass(frozen=True)
class MeasuredSet:
    """A record, of which a first `part` identifies, the structure, and what others publish of the rest."""

    name: str
    record: lw.Record
    structure: lw.Structure
    published: str
    part: float = 0.6
    options: Mapping[str, Any] = field(default_factory=dict)
    burn: float | None = None


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


SETS: tuple[Callable[[], MeasuredSet], ...] = (
    emps,
    silverbox,
    bouc_wen,
    storey,
    magnet_beam,
    mr_damper,
    friction_damper,
)


def row(measured: MeasuredSet) -> tuple[str, ...]:
    """What is asked, the grade, the time, and what is left of the rest by root mean squares."""
    record, split = measured.record, round(measured.part * len(measured.record))
    started = perf_counter()
    fit = lw.identify(record[:split], measured.structure, **measured.options)
    seconds = perf_counter() - started
    law = "; ".join(link.law.text for link in measured.structure.links)
    try:
        channels = lw.validate(record[split:], fit).channels
    except lw.LinkwiseError as error:
        left = str(error).partition(";")[0]
    else:
        left = ", ".join(
            f"{channel}: {scores.rmse:.3g} {scores.unit} ({scores.nmse_percent**0.5 * 10.0:.2g} %)"
            for channel, scores in channels.items()
        )
    return measured.name, f"`{law}`", fit.grade.value, f"{seconds:.1f} s", left, measured.published


def rows() -> Iterator[tuple[str, ...]]:
    """The title and a row for each set that is there."""
    yield "set", "law", "grade", "time", "left of the rest", "published"
    for make in SETS:
        try:
            measured = make()
        except (OSError, lw.RecordError):
            print(f"no {make.__name__} beside the checkout")
            continue
        yield row(measured)


if __name__ == "__main__":
    for cells in rows():
        print(f"| {' | '.join(cells)} |", flush=True)
