"""Exported equations of motion: each language computes what linkwise does, integrates alike, and holds no text as code."""

import ctypes
import re
import runpy
import shutil
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from zipfile import ZipFile

import numpy as np
import pytest
import scipy
from commands import document, refusal, said
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    LAWS,
    MEMORY,
    MEMORY_STATES,
    Value,
    host,
    link,
    structure,
    torsion_chain,
)
from structures import NES as NES_LAW

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.export import export_equations
from linkwise.export.equations import EQUATIONS
from linkwise.simulation.energy import LinkForces

GCC = shutil.which("gcc")
needs_gcc = pytest.mark.skipif(GCC is None, reason="needs gcc")
STRICT = ("-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror", "-trigraphs", "-shared", "-fPIC")
NES = {"alpha": -100.0, "beta": 1e6, "c": 0.02}


def of_every_kind() -> lw.Structure:
    """A host of three modes, a moving base, every function of laws, a shared coefficient, and memory."""
    shared: dict[str, Value] = {**NES, "alpha": lw.Coefficient.shared("sink.alpha")}
    return structure(
        {"m1": 2.0, "m2": 0.5},
        *(link(name, "m2-m1", law, **values) for name, (law, values) in LAWS.items()),
        link("sink", "m1-base", NES_LAW, **NES),
        link("other", "m2-beam.tip", NES_LAW, **shared),
        link("joint", "beam.mid-m1", "k*d + c*v + F*z", MEMORY_STATES, **MEMORY),
        hosts=[host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES, between={(1, 3): 0.4})],
        name='every "kind" */ of ??/',
    )


def compiled(path: Path) -> ctypes.CDLL:
    """The library of C sources, without a warning from the compiler."""
    library = path.with_suffix(".so")
    subprocess.run([str(GCC), *STRICT, str(path), "-o", str(library), "-lm"], check=True)
    return ctypes.CDLL(str(library))


Function = Callable[[Floats, Floats | None], Floats]


def of_python(path: Path, name: str, shape: tuple[int, ...]) -> Function:
    function = runpy.run_path(str(path))[name]
    return lambda z, u: np.asarray(function(0.0, z, u))


def of_c(path: Path, name: str, shape: tuple[int, ...]) -> Function:
    function = compiled(path)[name]
    pointer = np.ctypeslib.ndpointer(dtype=float)
    function.argtypes = [ctypes.c_double, pointer, ctypes.c_void_p, ctypes.c_void_p, pointer]

    def called(z: Floats, u: Floats | None) -> Floats:
        result = np.full(shape, np.nan)
        function(0.0, np.ascontiguousarray(z), None if u is None else u.ctypes.data, None, result)
        return result

    return called


def of_matlab(path: Path, name: str, shape: tuple[int, ...]) -> Function:
    """The statements of a function of MATLAB by Python, for the little of that language that equations have."""
    text = path.read_text(encoding="utf-8")
    own = {"rhs": "rates_of"}.get(name, f"{name}_of")
    body = text.partition(f"function result = {own}(z, u, p)\n")[2].partition("\nend\n")[0]
    values = re.search(r"^info\.values = \[(.*)\];$", text, re.MULTILINE)
    assert values is not None

    def element(match: re.Match[str]) -> str:
        return f"{match[1]}[{', '.join(str(int(number) - 1) for number in match[2].split(', '))}]"

    for matlab, python in ((".*", "*"), ("./", "/"), (".^", "**"), ("%", "#")):
        body = body.replace(matlab, python)
    lines = re.sub(r"\b([zup]|result)\(([\d, ]+)\)", element, body).splitlines()[1:]
    known = {name: getattr(np, name) for name in ("abs", "sign", "sqrt", "exp", "tanh", "sin", "cos", "log")}
    known |= {"max": np.maximum, "min": np.minimum, "real_or_nan": lambda x: x}

    def called(z: Floats, u: Floats | None) -> Floats:
        p = np.array([float(value) for value in values[1].split("; ")])
        result = np.zeros(shape if name != "rhs" else shape[:1])
        given = {"z": z, "u": np.zeros(99) if u is None else u, "p": p, "result": result}
        with np.errstate(all="ignore"):
            exec("\n".join(lines), {**known, **given})
        return result

    return called


@pytest.fixture(scope="module", params=[".py", ".m", pytest.param(".c", marks=needs_gcc)])
def language(request: pytest.FixtureRequest) -> str:
    return str(request.param)


def functions(subject: lw.Structure, suffix: str, folder: Path) -> tuple[Function, Function, Function]:
    """rhs, jacobian and input_jacobian in a language."""
    module = runpy.run_path(str(export_equations(subject, folder / "names.py")))
    size, inputs = len(module["STATES"]), len(module["INPUTS"])
    path = export_equations(subject, folder / f"motion{suffix}")
    reader = {".py": of_python, ".m": of_matlab, ".c": of_c}[suffix]
    jacobian, by_inputs = (
        reader(path, "jacobian", (size, size)),
        reader(path, "input_jacobian", (size, inputs)),
    )
    return reader(path, "rhs", (size,)), jacobian, by_inputs


def assert_jacobians(rhs: Function, jacobian: Function, by_inputs: Function, z: Floats, u: Floats) -> None:
    """They agree with differences of the rates."""
    by_state = [(rhs(z + step, u) - rhs(z - step, u)) / 2e-6 for step in 1e-6 * np.eye(z.size)]
    by_input = [(rhs(z, u + step) - rhs(z, u - step)) / 2e-6 for step in 1e-6 * np.eye(u.size)]
    for exact, differences in ((jacobian(z, u), by_state), (by_inputs(z, u), by_input)):
        scale = np.abs(exact).max()
        assert exact / scale == pytest.approx(np.transpose(differences) / scale, abs=1e-6)


def motions(size: int, count: int = 4) -> Iterator[Floats]:
    rng = np.random.default_rng(51)
    return iter(rng.normal(size=(count, size)) * 0.02)


def test_rates_are_those_of_the_structure(language: str, tmp_path: Path) -> None:
    subject = of_every_kind()
    module = runpy.run_path(str(export_equations(subject, tmp_path / "names.py")))
    places = "beam.tip", "beam.mid", "beam.root", "m1", "m2"
    inputs = [*(f"force:{place}" for place in places), "x:base", "v:base"]
    assert module["INPUTS"] == inputs and module["STATES"][-1] == "state:joint.z"
    assert "other.alpha" not in module["PARAMETERS"] and module["PARAMETERS"]["sink.alpha"] == -100.0
    rhs, *_ = functions(subject, language, tmp_path)
    n, rng = subject.size, np.random.default_rng(5)
    for z in motions(len(module["STATES"])):
        u = rng.normal(size=7) * np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.01, 0.1])
        base = lw.model.TimeFunction(f"{float(u[5])!r} + {float(u[6])!r}*t")
        drive = lw.model.Excitation(forces=dict(zip(places, u.tolist(), strict=False)), base=base)
        state = z[None, :n], z[None, n : 2 * n], z[None, 2 * n :]
        acceleration = LinkForces(subject, drive).accelerations(np.zeros(1), *state)[0]
        joint = subject.links.index(subject.link("joint"))
        d = subject.elongations(z[:n], u[5])[joint], subject.elongations(z[n : 2 * n], u[6])[joint]
        (rate,) = subject.link("joint").law.state_rates(*d, {**MEMORY, "z": z[-1]})
        # an identity; sums of forces of 1e4 N in another order
        expected = np.array([*z[n : 2 * n], *acceleration, float(rate)])
        assert rhs(z, u) == pytest.approx(expected, rel=1e-12, abs=1e-9, nan_ok=True)


def speaker() -> lw.Structure:
    """A voice coil driven by its voltage, and a valve beside it."""
    coil = lw.Law.parse("k*d - Bl*i", {"i": "(u - R*i - Bl*v)/L"}, signals={"w": "A", "u": "V"})
    valve = lw.Law.parse("(c0 + cw*w**2 + cu*u*w)*v", signals={"w": "A", "u": "V"})
    return structure(
        {"m1": 0.5, "m2": 0.2},
        link("coil", "m1-ground", coil, k=400.0, Bl=5.0, R=4.0, L=0.05),
        link("valve", "m2-m1", valve, c0=2.0, cw=3.0, cu=0.7),
    )


def test_signals_are_inputs(language: str, tmp_path: Path) -> None:
    subject = speaker()
    module = runpy.run_path(str(export_equations(subject, tmp_path / "names.py")))
    assert module["INPUTS"] == ["force:m1", "force:m2", "signal:u", "signal:w"]
    assert module["UNITS"]["signal:u"] == "V"
    rhs, jacobian, input_jacobian = functions(subject, language, tmp_path)
    u = np.array([0.3, -0.2, 1.5, 0.4])
    signals = {"u": 1.5, "w": 0.4}
    for z in motions(5, 2):
        x, v, i = z[:2], z[2:4], float(z[4])
        coil, valve = subject.links
        pull, push = (
            coil.force(x[0], v[0], {"i": i, **signals}),
            valve.force(x[1] - x[0], v[1] - v[0], signals),
        )
        (rate,) = coil.law.state_rates(x[0], v[0], {**coil.values, "i": i, **signals})
        expected = [*v, (0.3 - float(pull) + float(push)) / 0.5, (-0.2 - float(push)) / 0.2, float(rate)]
        assert rhs(z, u) == pytest.approx(expected, rel=1e-12)
        assert_jacobians(rhs, jacobian, input_jacobian, z, u)


def smooth() -> lw.Structure:
    """The same without laws that have kinks or are no numbers for some elongations, and one with a coefficient as exponent."""
    subject = of_every_kind()
    dropped = {"friction", "stops", "roots"}
    links = tuple(own for own in subject.links if own.name not in dropped | subject.modes)
    masses = tuple(own for own in subject.masses if own.name not in subject.modes)
    law = "k*d*(1 + d*d/w)**p + c*exp(0.1*d/w)*v**3"
    power = link("power", "m1-ground", law, k=30.0, w=1e-3, p=0.7, c=2.0)
    return lw.Structure(subject.name, masses, (*links, power), subject.hosts)


def test_jacobians_agree_with_differences(language: str, tmp_path: Path) -> None:
    subject = smooth()
    of_motion = functions(subject, language, tmp_path)
    for z in motions(subject.topology.dimension, 2):
        assert_jacobians(*of_motion, z, np.linspace(-0.01, 0.02, 7))


@pytest.mark.parametrize("masses", [2, 4])
def test_exports_integrate_like_the_simulation(masses: int, language: str, tmp_path: Path) -> None:
    subject, release = lw.bnes_chain(masses), {"v:m1": 1.0}
    # s; neighbours of four part soon
    duration = {".m": 0.04, ".py": 0.2, ".c": 0.5 if masses == 2 else 0.2}[language]
    record = lw.simulate(subject, release=release, duration=duration, rate=100.0, sensors=["x", "v"])
    assert record.simulated is not None and record.simulated.horizon is None
    rhs, *_ = functions(subject, language, tmp_path)
    start = np.zeros(2 * masses)
    start[masses] = 1.0
    solved = scipy.integrate.solve_ivp(
        lambda t, z: rhs(z, None), (0.0, duration), start, method="DOP853", rtol=3e-14, atol=1e-15,
        t_eval=record.time,
    )  # fmt: skip
    sizes = np.abs(record.values).max(axis=0)
    assert (solved.y.T / sizes) == pytest.approx(record.values / sizes, abs=1e-9)


@needs_gcc
def test_kinks_and_trust_are_said_in_every_language(tmp_path: Path) -> None:
    subject = structure({"m1": 1.0}, link("stop", "m1-ground", "k*max(d - g, 0) + c*v", k=1e4, g=0.01, c=0.3))
    file = tmp_path / "structure.toml"
    file.write_text(f"# NOT to be trusted (not converged): numbers.\n\n{lw.model.format_structure(subject)}")
    for suffix in EQUATIONS:
        said(f"export {file} --equations {tmp_path / 'motion'}{suffix}", 3)
        path = tmp_path / f"motion{suffix}"
        text = path.read_text() if suffix != ".fmu" else ZipFile(path).read("sources/motion.c").decode()
        assert "(kinks: not smooth where d - g = 0)" in text and "NOT to be trusted" in text
        assert "the laws of stop have kinks" in text


def test_the_command_writes_equations_beside_forces_or_alone(tmp_path: Path) -> None:
    file = tmp_path / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), file)
    files = [str(tmp_path / name) for name in ("forces.py", "motion.py", "motion.c")]
    written = document(f"export {file} {files[0]} --equations {files[1]} --equations {files[2]}")
    assert written == {"files": files} and all(Path(name).exists() for name in files)
    assert "def force_nes1" in Path(files[0]).read_text() and "def rhs" in Path(files[1]).read_text()
    assert "nothing to write" in refusal(f"export {file}")
    assert "equations cannot be exported to .mat; choose from .py, .m, .c, .fmu" in refusal(
        f"export {file} --equations {tmp_path / 'a.mat'}"
    )
    assert "is not the name of a function" in refusal(f"export {file} --equations '{tmp_path / 'a b.m'}'")
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), file)
    assert "identify it first" in refusal(f"export {file} --equations {tmp_path / 'a.py'}")
    rig = lw.Structure("rig", (), (link("s", "base-ground", "k*d", k=1.0),))
    with pytest.raises(lw.StructureError, match="there is no mass"):
        export_equations(rig, tmp_path / "rig.py")


class Unit:
    """The library of a unit for co-simulation by its interface, as an importer calls it."""

    def __init__(self, path: Path) -> None:
        with ZipFile(path) as archive:
            self.files = archive.namelist()
            root = ElementTree.fromstring(archive.read("modelDescription.xml"))
            (binary,) = (name for name in self.files if name.startswith("binaries/"))
            library = ctypes.CDLL(archive.extract(binary, path.with_suffix("")))
        self.variables = {own.attrib["name"]: own.attrib for own in root.iter("ScalarVariable")}
        given = [own for own in root.iter("ScalarVariable") if "start" in own[0].attrib]
        self.starts = {own.attrib["name"]: float(own[0].attrib["start"]) for own in given}
        self.library = library
        library.fmi2Instantiate.restype = ctypes.c_void_p
        library.fmi2GetVersion.restype = ctypes.c_char_p
        guid = root.attrib["guid"].encode()
        started = library.fmi2Instantiate
        self.started: Callable[[bytes], Any] = lambda guid: started(b"unit", 1, guid, b"", None, 0, 0)
        self.instance = ctypes.c_void_p(self.started(guid))
        assert self.instance and library.fmi2GetVersion() == b"2.0"

    def reference(self, name: str) -> Any:
        return (ctypes.c_uint * 1)(int(self.variables[name]["valueReference"]))

    def set(self, name: str, value: float) -> int:
        given = (ctypes.c_double * 1)(value)
        return int(self.library.fmi2SetReal(self.instance, self.reference(name), ctypes.c_size_t(1), given))

    def get(self, name: str) -> float:
        result = (ctypes.c_double * 1)()
        assert self.library.fmi2GetReal(self.instance, self.reference(name), ctypes.c_size_t(1), result) == 0
        return result[0]

    def step(self, time: float, length: float) -> int:
        return int(self.library.fmi2DoStep(self.instance, ctypes.c_double(time), ctypes.c_double(length), 1))


@needs_gcc
def test_a_unit_moves_like_the_simulation(tmp_path: Path) -> None:
    subject = lw.bnes_chain(2)
    path = export_equations(subject, tmp_path / "chain 1.fmu")
    assert path.read_bytes() == export_equations(subject, tmp_path / "again" / "chain 1.fmu").read_bytes()
    unit = Unit(path)
    assert unit.files == ["modelDescription.xml", "sources/chain_1.c", "binaries/linux64/chain_1.so"]
    assert not unit.started(b"another one")
    outputs = [name for name, own in unit.variables.items() if own["causality"] == "output"]
    assert outputs == ["x:m1", "x:m2", "v:m1", "v:m2"]
    assert all(unit.get(name) == start for name, start in unit.starts.items())
    assert unit.set("v:m1", 1.0) == 0 and unit.set("force:m2", 0.3) == 0 and unit.set("step", 1e-5) == 0
    record = lw.simulate(
        subject, release={"v:m1": 1.0}, forces={"m2": 0.3}, duration=0.2, rate=100.0, sensors=["x", "v"]
    )
    for number, expected in enumerate(record.values[1:, :4], start=1):
        assert unit.step((number - 1) / 100.0, 0.01) == 0
        # of the fourth order in the step: measured 4e-9 of the motion
        assert [unit.get(name) for name in outputs] == pytest.approx(expected, rel=1e-7, abs=1e-9)
    state = ctypes.c_void_p()
    library = unit.library
    assert library.fmi2GetFMUstate(unit.instance, ctypes.byref(state)) == 0
    before = [unit.get(name) for name in outputs]
    unit.step(0.2, 0.01)
    assert library.fmi2SetFMUstate(unit.instance, state) == 0
    assert [unit.get(name) for name in outputs] == before
    assert library.fmi2FreeFMUstate(unit.instance, ctypes.byref(state)) == 0
    assert unit.set("step", 0.0) == 0 and unit.step(0.2, 0.01) == 3  # fmi2Error
    assert library.fmi2Reset(unit.instance) == 0
    assert all(unit.get(name) == start for name, start in unit.starts.items())
    library.fmi2FreeInstance(unit.instance)


@needs_gcc
def test_a_unit_of_every_kind_shows_points_of_hosts(tmp_path: Path) -> None:
    path = export_equations(of_every_kind(), tmp_path / "all.fmu")
    unit = Unit(path)
    with ZipFile(path) as archive:
        compiled(Path(archive.extract("sources/all.c", tmp_path)))
    for number in (1, 2, 3):
        assert unit.set(f"x:beam.mode{number}", 0.1 * number) == 0
    expected = sum(0.1 * number * shape for number, shape in enumerate(CANTILEVER_SHAPES["mid"], start=1))
    assert unit.get("x:beam.mid") == pytest.approx(expected, rel=1e-12)
    assert unit.variables["x:beam.mid"]["initial"] == "calculated"
    assert unit.set("x:beam.mid", 1.0) == 3 and unit.variables["state:joint.z"]["causality"] == "local"


@needs_gcc
def test_fmpy_runs_a_unit(tmp_path: Path) -> None:
    fmpy = pytest.importorskip("fmpy")
    validation = pytest.importorskip("fmpy.validation")
    path = export_equations(lw.bnes_chain(2), tmp_path / "chain.fmu")
    assert validation.validate_fmu(str(path)) == []
    run = fmpy.simulate_fmu(str(path), start_values={"v:m1": 1.0}, stop_time=0.2, output_interval=0.01)
    record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=0.2, rate=100.0)
    assert run["x:m2"] == pytest.approx(record.channel("x:m2"), rel=1e-7, abs=1e-9)


def test_without_a_compiler_a_unit_has_sources_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    file = tmp_path / "chain.toml"
    lw.write_structure(lw.bnes_chain(2), file)
    assert "no C compiler" in said(f"export {file} --equations {tmp_path / 'a.fmu'}").err
    assert ZipFile(tmp_path / "a.fmu").namelist() == ["modelDescription.xml", "sources/a.c"]


@needs_gcc
def test_a_compiler_that_fails_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CC", "false")
    with pytest.raises(lw.OutputError, match=r"false refused the sources .* set CC to another one"):
        export_equations(lw.bnes_chain(2), tmp_path / "a.fmu")


def test_rotations_have_their_units(tmp_path: Path) -> None:
    module = runpy.run_path(str(export_equations(torsion_chain(), tmp_path / "torsion.py")))
    assert [module["UNITS"][name] for name in ("x:disc1", "v:disc2", "force:disc1", "disc1.mass")] == [
        "rad", "rad/s", "N m", "kg m^2",
    ]  # fmt: skip
