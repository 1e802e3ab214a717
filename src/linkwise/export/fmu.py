"""The equations of motion as a unit for co-simulation, FMI 2.0: a zip file of a description, C sources and a binary."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
import uuid
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import version
from importlib.resources import files
from pathlib import Path
from zipfile import ZIP_DEFLATED, ZipFile, ZipInfo

import numpy as np

from linkwise.display import identifiers, on_one_line
from linkwise.errors import OutputError
from linkwise.export.answer import rendered
from linkwise.export.c import KEYWORDS, C, literal, source
from linkwise.export.equations import EquationsOfMotion
from linkwise.expression import symbols
from linkwise.expression.tree import to_code

_STEPS = 2000  # in the shortest period about the initial state, which shortens as hardening links stretch
_LONGEST = 1e-3  # s
_PLATFORMS = {"linux": ("linux64", ".so"), "darwin": ("darwin64", ".dylib"), "win32": ("win64", ".dll")}
_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
_EPOCH = (1980, 1, 1, 0, 0, 0)  # of every file in the archive, so that equal equations give equal files


def write_equations(equations: EquationsOfMotion, path: Path, name: str) -> None:
    """Write the unit, which has the `name` of its file. OutputError where the compiler of the machine refuses the sources."""
    (model,) = identifiers([name], KEYWORDS).values()
    content = CoSimulationUnit.of(equations)
    code, description = content.source(), content.description(model)
    contents = {"modelDescription.xml": description, f"sources/{model}.c": code.encode("ascii")}
    platform, suffix = _PLATFORMS.get(sys.platform, _PLATFORMS["linux"])
    if (binary := _compiled(code, suffix)) is not None:
        contents[f"binaries/{platform}/{model}{suffix}"] = binary
    with ZipFile(path, "w") as archive:
        for file, written in contents.items():
            archive.writestr(ZipInfo(file, _EPOCH), written, ZIP_DEFLATED)


def compiler() -> str | None:
    """The C compiler of this machine, that of the variable CC first; None where there is none."""
    return next(
        (found for name in (os.environ.get("CC", ""), "cc", "gcc", "clang") if name and (found := shutil.which(name))),
        None,
    )  # fmt: skip


def _compiled(code: str, suffix: str) -> bytes | None:
    """The shared library of the sources; None without a compiler."""
    if (command := compiler()) is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file, library = Path(folder, "model.c"), Path(folder, f"model{suffix}")
        file.write_text(code, encoding="ascii")
        done = subprocess.run(
            [command, *_FLAGS, str(file), "-o", str(library), "-lm"],
            capture_output=True, text=True, errors="replace", check=False,
        )  # fmt: skip
        if done.returncode != 0 or not library.exists():
            raise OutputError(
                f"the compiler {command} refused the sources of the unit ({on_one_line(done.stderr.strip())[:300]}); set CC "
                "to another one, or export the equations to a .c file"
            )
        return library.read_bytes()


@dataclass(frozen=True)
class _Variable:
    """A real variable of a unit; its place in the list is its reference."""

    name: str
    unit: str
    causality: str
    start: float | None
    description: str = ""


@dataclass(frozen=True, eq=False)
class CoSimulationUnit:
    """A unit: equations, the step of RK4 in s, and the variables, those of the instance first."""

    equations: EquationsOfMotion
    step: float
    variables: tuple[_Variable, ...]

    @classmethod
    def of(cls, equations: EquationsOfMotion) -> CoSimulationUnit:
        step, shown = _step(equations), equations.shown
        variables = [
            _Variable(name, unit, "output" if name in shown else "local", start)
            for (name, unit), start in zip(equations.states.items(), equations.initial, strict=True)
        ]
        variables += [_Variable(name, unit, "input", 0.0) for name, unit in equations.inputs.items()]
        units, values = equations.units, equations.parameters.items()
        variables += [_Variable(name, units[name], "parameter", value) for name, value in values]
        longest = "longest step of the integration by a Runge-Kutta method of order 4"
        variables.append(_Variable("step", "s", "parameter", step, longest))
        rotations = equations.structure.rotations
        for name in shown:
            if name not in equations.states:
                kind, _, place = name.partition(":")
                unit = ("rad" if place in rotations else "m") + ("/s" if kind == "v" else "")
                variables.append(_Variable(name, unit, "output", None))
        return cls(equations, step, tuple(variables))

    @cached_property
    def points(self) -> list[str]:
        """The outputs that are no states: motions of points of hosts."""
        return [variable.name for variable in self.variables if variable.start is None]

    @cached_property
    def guid(self) -> str:
        """What tells the unit from others: equal equations have an equal one."""
        written = f"{source(self.equations)}{self.step!r}{version('linkwise')}"
        return f"{{{uuid.uuid5(uuid.NAMESPACE_URL, written)}}}"

    def source(self) -> str:
        """The C sources."""
        names = self.equations.identifiers(KEYWORDS)
        used = {name for point in self.points for name in symbols(self.equations.shown[point])}
        states = [(number, name) for number, name in enumerate(self.equations.states) if name in used]
        lines = [f"    const double {names[name]} = z[{number}];" for number, name in states]
        codes = [to_code(self.equations.shown[point], C, names) for point in self.points]
        lines += [f"    y[{number}] = {code};" for number, code in enumerate(codes)]
        head = f"#define GUID {literal(self.guid)}\n#define POINTS {len(self.points)}\n#define LONGEST_STEP {self.step!r}"
        shown = ["static void shown(const double *z, double *y)", "{", "    (void)z, (void)y;", *lines, "}"]
        unit = files("linkwise.export").joinpath("fmi2.c").read_text(encoding="ascii")
        return "\n".join([source(self.equations), head, "", *shown, "", unit])

    def description(self, model: str) -> bytes:
        """The description of the unit in XML."""
        numbered = list(enumerate(self.variables, 1))
        text = rendered(
            "modelDescription.xml.jinja",
            model=model,
            guid=self.guid,
            equations=self.equations,
            notes=list(self.equations.notes),
            variables=self.variables,
            outputs=[number for number, variable in numbered if variable.causality == "output"],
            calculated=[number for number, variable in numbered if variable.start is None],
            plain=on_one_line,
            repr=repr,
        )
        return text.encode("utf-8")


def _step(equations: EquationsOfMotion) -> float:
    """The step in s: a part of the shortest period or time constant about the initial state."""
    given = {**equations.parameters, **dict.fromkeys(equations.inputs, 0.0)}
    given |= zip(equations.states, equations.initial, strict=True)
    matrix = np.zeros((len(equations.states),) * 2)
    for place, value in equations.jacobian.evaluated(given).items():
        matrix[place] = value
    fastest = float(np.abs(np.linalg.eigvals(np.nan_to_num(matrix))).max())
    return float(f"{min(2.0 * np.pi / (_STEPS * fastest), _LONGEST):.1e}") if fastest > 0.0 else _LONGEST
