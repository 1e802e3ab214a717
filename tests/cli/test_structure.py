"""`linkwise structure`, and what every command has in common: help with examples, a version, a pipe that closes."""

import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from commands import document, said
from structures import link, named, structure

import linkwise as lw
from linkwise.cli import COMMANDS, linkwise
from linkwise.cli.structure import structure as structure_commands

PENDULUM = structure({"bob": 1.0}, link("string", "bob-ground", "m*g*sin(d/L)", m=1.0, g=9.81, L=1.0))


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def shown(subject: lw.Structure | str) -> str:
    """What `show` prints of a structure, or of the text of its file."""
    text = subject if isinstance(subject, str) else lw.model.format_structure(subject)
    Path("shown.toml").write_text(text)
    return said("structure show shown.toml").out


def test_bnes_prints_or_writes_the_chain() -> None:
    chain = lw.bnes_chain(4)
    for option, expected in (
        ("", chain),
        ("--unknown nes", chain.unknown("nes")),
        ("--unknown all", chain.unknown("all")),
    ):
        out, err = said(f"structure bnes --dof 4 {option}")
        assert lw.parse_structure(out, "printed") == expected and err == ""
    assert said("structure bnes --dof 2 -o chain.toml") == ("", "")
    assert lw.read_structure("chain.toml") == lw.bnes_chain(2)
    assert [mass["name"] for mass in document("structure bnes --dof 2")["mass"]] == ["m1", "m2"]


def test_show_tells_masses_links_and_rests() -> None:
    out = shown(lw.bnes_chain(2))
    law = "alpha*d + beta*d**3 + c*v; alpha = -100 N/m, beta = 1e+06 N/m^3, c = 0.02 N s/m"
    assert f"nes1       m2 - m1: {law}" in out
    assert "equilibria: 2 stable, 1 unstable." in out
    assert "m1 = 0 m, m2 = 0.01 m; energy -0.0025 J" in out  # alpha^2/(4 beta)
    assert "27.83 Hz" in out
    printed = document("structure show shown.toml")
    assert printed["equilibria"]["stable"] == 2 and printed["link"][0]["name"] == "spring1"
    assert "and 4 more stable ones" in shown(lw.bnes_chain(6))


def test_a_result_folder_stands_for_its_structure(answer_folder: Path, tmp_path: Path) -> None:
    file = answer_folder / "structure.toml"
    assert said(f"structure show {answer_folder}").out == said(f"structure show {file}").out
    said(f"simulate {answer_folder} --duration 0.01 --rate 1000 --release v:m1=1 -o {tmp_path}/short.csv")
    partial = lw.model.read_partial_structure
    assert partial(answer_folder).links == partial(file).links
    for line in (
        "identify run.csv FOLDER",
        "compare run.csv FOLDER",
        "identify run.csv s.toml --truth FOLDER",
    ):
        err = said(line.replace("FOLDER", str(answer_folder)), 2).err
        assert "is a directory" not in err and "there is no such file" in err
    with pytest.raises(lw.StructureError, match=r"no structure\.toml in this folder"):
        partial(tmp_path)


def test_show_tells_which_coefficient_is_shared() -> None:
    text = lw.model.format_structure(lw.bnes_chain(2).unknown("nes1.c"))
    out = shown(text.replace("c = 1.0", 'c = "=nes1.c"'))
    assert "c = nes1.c in N s/m" in out and "c = unknown N s/m" in out


def test_show_tells_states() -> None:
    values = dict.fromkeys(lw.model.named_law("coil").coefficients, 2.0)
    out = shown(structure({"m1": 1.0}, named("coil", "m1-ground", "coil", **values)))
    assert "i' = (g*v - R*i)/L; i in A, 0 at the start" in out
    assert "equilibria and modes are not shown: link coil has memory" in out


@pytest.mark.parametrize(
    ("chain", "why"),
    [
        (lw.bnes_chain(2).unknown("nes"), "coefficients are unknown"),
        (lw.bnes_chain(22), "more than 20 masses"),
        (PENDULUM, 'link "string": the force vanishes at more than 64 elongations'),
    ],
)
def test_show_says_why_it_shows_no_rests(chain: lw.Structure, why: str) -> None:
    assert why in shown(chain)


def test_named_laws_are_listed_and_printed_as_links_to_edit() -> None:
    listed = said("structure laws").out
    assert "iwan(6): sliders in parallel" in listed and "z' = (v - s*abs(v)*z" in listed
    table = said("structure laws 'iwan(2)'").out
    masses = "".join(f'[[mass]]\nname = "{name}"\nmass = 1.0\n' for name in ("m1", "m2"))
    assert lw.parse_structure(masses + table).link("iwan").law.states == ("u1", "u2", "ub")
    assert 'on a rig "base" and "ground"' in table
    on_rig = table.replace('between = ["m2", "m1"]', 'between = ["base", "ground"]')
    assert lw.parse_structure(on_rig).on_rig
    piezo = document("structure laws piezo")["piezo"]
    assert piezo["states"]["V"] == {"rate": "(-theta*v - V/R)/C", "unit": "V"}
    assert piezo["coefficients"]["theta"]["unit"] == "N/V"


def commands_with_help() -> Iterator[click.Command]:
    """All commands, those of groups too."""
    yield linkwise
    for name in COMMANDS:
        command = linkwise.commands[name]
        yield command
        yield from command.commands.values() if isinstance(command, click.Group) else ()


@pytest.mark.parametrize(
    "command", ["", *COMMANDS, *(f"structure {name}" for name in structure_commands.commands)]
)
def test_every_help_has_an_example(command: str) -> None:
    example = re.split("Examples?:\n", said(f"{command} --help").out)[-1]
    assert example.strip().startswith(f"linkwise {command}".strip())


def test_every_example_of_help_is_right_usage() -> None:
    """Parsed and not run: a hum without a unit was refused for want of a unit."""
    helps = ((command.help or "").replace("\\\n", " ") for command in commands_with_help())
    lines = [line.strip() for text in helps for line in text.splitlines()]
    texts = [line for line in lines if line.startswith("linkwise ")]
    assert len(texts) > 50
    for text in texts:
        words = shlex.split(text)[1:]
        command: click.Command = linkwise
        while isinstance(command, click.Group):
            command = command.commands[words.pop(0)]
        command.make_context(command.name, words)
    with pytest.raises(click.UsageError, match="loud"):
        linkwise.commands["identify"].make_context(
            "identify", ["a.csv", "b.toml", "--calibration", "x:m1=loud"]
        )


def test_a_reader_that_goes_away_is_no_error() -> None:
    """`linkwise ... | head -1` closes the pipe early."""
    command = f"{sys.executable} -m linkwise structure bnes --dof 1000 | head -1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.stdout.startswith("name = ") and result.stderr == ""


def test_version_is_that_of_the_package() -> None:
    assert lw.__version__ in said("--version").out
