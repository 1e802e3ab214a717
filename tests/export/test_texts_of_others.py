"""What somebody else wrote into a file is text in what is exported of it, and never code."""

import ast
import builtins
import csv
import json
import re
import runpy
from collections.abc import Callable
from pathlib import Path
from xml.etree import ElementTree

import openpyxl
import pytest
from structures import host, structure

import linkwise as lw
from linkwise.export import export_equations
from linkwise.export.answer import ExportedAnswer
from linkwise.export.equations import EquationsOfMotion
from linkwise.export.fmu import CoSimulationUnit

pytestmark = pytest.mark.slow


RUN = "setattr(__import__('builtins'), 'ran', 1)"
TEXTS = (
    f'"""+str({RUN})+"""',
    f"'''+str({RUN})+'''",
    f"x\\\"\"\"\n{RUN}\n\"\"\"",
    *(f"x{end}{RUN}{end}x" for end in ("\n", "\r", "\r\n", "\v", "\f", "\x85", "\u2028", "\u2029", "\0")),
    *(f"{blank}v" for blank in "\n\r\v\f\x1c\x85\u2028"),  # which stand between the parts of a law
    f"'); {RUN}; ('",
    f"... \n{RUN}",
    f"\n%{{\n{RUN}\n%}}\n",
    f'converged"""\n{RUN}',
    "x\\",
    "+cmd|' 'C'!A0",
    f"*/ {RUN}; /*",
    f"??/\n{RUN};",
    f"?κ/\n{RUN};",
    f"]]>&lt;<{RUN}/>",
    "=1+1",
    "{0.__class__}",
    "\ud800",
)  # fmt: skip
Door = Callable[[str, Path], lw.Structure | Path]
CASES = Path(__file__).parents[3] / "shared" / "cases" / "export-code"


def linked(
    *,
    mass: str = "m",
    link: str = "s",
    law: str = "k*d - p*d",
    state: str = "z",
    rate: str = "v",
    unit: str = "m",
    coefficient: str = "q",
    name: str = "x",
    turns: bool = False,
) -> lw.Structure:
    """A mass on a link with memory."""
    states = {state: lw.model.LinkState(f"{rate} - h*{state}", unit=unit)}
    parsed = lw.Law.parse(f"{law} + g*{state} + {coefficient}*v", states)
    spring = lw.Link(link, (mass, "ground"), parsed, dict.fromkeys(parsed.coefficients, 2.0))
    return structure({mass: 1.0}, spring, name=name, rotations=[mass] if turns else [])


def of_a_host(name: str, point: str) -> lw.Structure:
    spring = lw.Link("s", (f"{name}.{point}", "ground"), lw.Law.parse("k*d"), {"k": 2.0})
    return structure({}, spring, hosts=[host(name, [20.0], 0.01, {point: [1.0]}, rotations=[point])])


def commented(text: str, folder: Path) -> Path:
    """A structure file with a comment on its trust."""
    path = folder / "structure.toml"
    content = f"# NOT to be trusted ({text}): numbers.\n\n{lw.model.format_structure(linked())}"
    path.write_text(content, encoding="utf-8", errors="replace", newline="")
    return path


def stating(text: str, folder: Path) -> Path:
    """A result folder with a status."""
    lw.write_structure(linked(), folder / "structure.toml")
    result = json.dumps({"status": text, "trusted": False})
    (folder / "result.json").write_text(result)
    return folder


DOORS: dict[str, Door] = {
    "structure": lambda text, _: linked(name=text),
    "mass": lambda text, _: linked(mass=text),
    "rotation": lambda text, _: linked(mass=text, turns=True),
    "link": lambda text, _: linked(link=text),
    "coefficient": lambda text, _: linked(coefficient=text),
    "law": lambda text, _: linked(law=f"k*d - p*{text}"),
    "state": lambda text, _: linked(state=text),
    "rate": lambda text, _: linked(rate=text),
    "unit": lambda text, _: linked(unit=text),
    "host": lambda text, _: of_a_host(text, "tip"),
    "point": lambda text, _: of_a_host("beam", text),
    "comment": commented,
    "status": stating,
}
USUAL = {
    **dict.fromkeys(DOORS, "κ"),
    **dict.fromkeys(("coefficient", "law", "rate"), "v"),
    **dict.fromkeys(("comment", "status"), "not converged"),
    "state": "w",
    "unit": "m",
}
OPEN = {"structure", "mass", "rotation", "link", "comment"}  # to texts with quotation marks


def matlab_code(path: Path) -> list[str]:
    """The lines of the file but for comments and what stands in quotation marks, ended by whatever ends a line anywhere."""
    lines = [line.strip() for line in path.read_bytes().decode().splitlines()]
    assert not {"%{", "%}"} & set(lines)
    return [re.sub(r"'(?:[^']|'')*'", "''", line) for line in lines if not line.startswith("%")]


def c_code(text: str) -> list[str]:
    """The lines of C as the compiler reads them, without strings and comments: trigraphs and joined lines are undone first."""
    joined = text.replace("??/", "\\").replace("\\\n", " ")
    parts = re.sub(r'"(?:[^"\\\n]|\\.)*"|//[^\n]*|/\*.*?\*/', "''", joined, flags=re.DOTALL)
    return parts.splitlines()


def check_equations(answer: lw.Structure | Path, folder: Path) -> None:
    """No text is code in the equations of motion, in any language."""
    hostile = r"\b(setattr|builtins|cmd|__import__)\b"
    for suffix in (".py", ".m", ".c"):
        path = export_equations(answer, folder / f"motion{suffix}")
        text = path.read_text(encoding="utf-8")
        if suffix == ".py":
            runpy.run_path(str(path))
            assert not hasattr(builtins, "ran")
            nodes = ast.walk(ast.parse(text))
            assert not {"setattr", "__import__"} & {node.id for node in nodes if isinstance(node, ast.Name)}
        elif suffix == ".m":
            assert not re.search(hostile, "".join(matlab_code(path)))
        else:
            assert text.isascii() and not re.search(hostile, "".join(c_code(text)))
    content = CoSimulationUnit.of(EquationsOfMotion(ExportedAnswer.of(answer)))
    root = ElementTree.fromstring(content.description("model"))
    names = [own.attrib["name"] for own in root.iter("ScalarVariable")]
    assert names == [variable.name for variable in content.variables]
    assert not re.search(hostile, "".join(c_code(content.source())))


@pytest.mark.parametrize("door", DOORS)
def test_no_text_is_code_of_an_export(door: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delattr(builtins, "ran", raising=False)
    usual = lw.export_answer(DOORS[door](USUAL[door], tmp_path), tmp_path / "usual.m")
    accepted = []
    for number, text in enumerate(TEXTS):
        try:
            answer = DOORS[door](text, tmp_path)
            module = lw.export_answer(answer, tmp_path / f"a{number}.py")
        except lw.LinkwiseError:
            continue
        accepted.append(text)
        content = runpy.run_path(str(module))
        assert not hasattr(builtins, "ran")
        nodes = ast.walk(ast.parse(module.read_text(encoding="utf-8")))
        assert not {"setattr", "__import__"} & {node.id for node in nodes if isinstance(node, ast.Name)}
        if isinstance(answer, lw.Structure):
            assert content["NAME"] == answer.name
            assert tuple(content["MASSES"]) == answer.mass_names
            assert content["BETWEEN"] == {link.name: link.between for link in answer.links}
        code = matlab_code(lw.export_answer(answer, tmp_path / f"a{number}.m"))
        assert len(code) == len(matlab_code(usual)) and not re.search("setattr|builtins|cmd", "".join(code))
        lw.export_answer(answer, tmp_path / f"a{number}.mat")
        with lw.export_answer(answer, tmp_path / "a.csv").open(encoding="utf-8-sig", newline="") as file:
            cells = [cell for row in csv.reader(file) for cell in row]
        assert not [cell for cell in cells if cell.startswith(tuple("=+@\t\r\n"))]
        book = openpyxl.load_workbook(lw.export_answer(answer, tmp_path / "a.xlsx"))
        assert "f" not in {cell.data_type for sheet in book for row in sheet for cell in row}
        check_equations(answer, tmp_path)
    assert (TEXTS[0] in accepted) == (door in OPEN)
    assert ("\nv" in accepted) == (door in {"structure", "coefficient", "law", "rate"})


@pytest.mark.skipif(not CASES.exists(), reason="needs ../shared")
def test_files_of_strangers_are_no_code_of_an_export(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    commands: list[str] = []
    monkeypatch.setattr("os.system", commands.append)
    for name in ("a_rotation_name.toml", "b_comment.toml"):
        module = lw.export_answer(CASES / name, tmp_path / "answer.py")
        assert "MASSES" in runpy.run_path(str(module)) and not commands
        code = matlab_code(lw.export_answer(CASES / name, tmp_path / "answer.m"))
        assert not re.search("__import__", "".join(code))
        check_equations(CASES / name, tmp_path)
    assert not commands
    with pytest.raises(lw.LinkwiseError, match=r"states the status .* which linkwise does not write"):
        lw.export_answer(CASES / "c_folder", tmp_path / "answer.py")
