"""`linkwise structure`, and what every command has in common: exit codes, one-paragraph errors, help with examples."""

from __future__ import annotations

import json
import re
import shlex
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from structures import link, named, structure

import linkwise as lw
from linkwise.cli import COMMANDS, linkwise, run
from linkwise.cli.structure import structure as structure_commands

PENDULUM = structure({"bob": 1.0}, link("string", "bob-ground", "m*g*sin(d/L)", m=1.0, g=9.81, L=1.0))


@pytest.mark.parametrize("unknown", [None, "nes", "all"])
def test_bnes_prints_the_chain_as_a_file(unknown: str | None, capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--unknown", unknown] if unknown else []
    assert run(["structure", "bnes", "--dof", "4", *options]) == 0
    out, err = capsys.readouterr()
    chain = lw.bnes_chain(4)
    assert lw.parse_structure(out, "printed") == (chain.unknown(unknown) if unknown else chain)
    assert err == ""


def test_bnes_writes_a_file_and_says_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "bnes", "--dof", "2", "-o", str(tmp_path / "chain.toml")]) == 0
    assert lw.read_structure(tmp_path / "chain.toml") == lw.bnes_chain(2)
    assert capsys.readouterr() == ("", "")


def test_bnes_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "bnes", "--dof", "2", "--json"]) == 0
    assert [mass["name"] for mass in json.loads(capsys.readouterr().out)["mass"]] == ["m1", "m2"]


def test_show_tells_masses_links_and_rests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    assert run(["structure", "show", str(tmp_path / "chain.toml")]) == 0
    out = capsys.readouterr().out
    assert (
        "nes1       m2 - m1: alpha*d + beta*d**3 + c*v; alpha = -100 N/m, beta = 1e+06 N/m^3, c = 0.02 N s/m"
        in out
    )
    assert "equilibria: 2 stable, 1 unstable." in out
    assert "m1 = 0 m, m2 = 0.01 m; energy -0.0025 J" in out  # alpha^2/(4 beta)
    assert "27.83 Hz" in out


def test_show_tells_which_coefficient_is_shared(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    text = lw.model.format_structure(lw.bnes_chain(2).unknown("nes1.c")).replace("c = 1.0", 'c = "=nes1.c"')
    (tmp_path / "chain.toml").write_text(text)
    assert run(["structure", "show", str(tmp_path / "chain.toml")]) == 0
    out = capsys.readouterr().out
    assert "c = nes1.c in N s/m" in out and "c = unknown N s/m" in out


def test_show_names_only_the_first_of_many_rests(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lw.write_structure(lw.bnes_chain(6), tmp_path / "chain.toml")
    assert run(["structure", "show", str(tmp_path / "chain.toml")]) == 0
    assert "and 4 more stable ones" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("chain", "why"),
    [
        (lw.bnes_chain(2).unknown("nes"), "coefficients are unknown"),
        (lw.bnes_chain(22), "more than 20 masses"),
        (PENDULUM, 'link "string": the force vanishes at more than 64 elongations'),
    ],
)
def test_show_says_why_it_shows_no_rests(
    chain: lw.Structure, why: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lw.write_structure(chain, tmp_path / "chain.toml")
    assert run(["structure", "show", str(tmp_path / "chain.toml")]) == 0
    assert why in capsys.readouterr().out


def test_show_as_json(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lw.write_structure(lw.bnes_chain(2), tmp_path / "chain.toml")
    assert run(["structure", "show", str(tmp_path / "chain.toml"), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["equilibria"]["stable"] == 2 and shown["link"][0]["name"] == "spring1"


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["structure", "bnes", "--dof", "3"], "the number of masses must be even and at least 2"),
        (["structure", "bnes"], "Missing option '--dof'. Try: linkwise structure bnes --help"),
        (["structure", "bnes", "--dof", "two"], "'two' is not a valid integer"),
        (["structure", "bnes", "--dof", "2", "--unknown", "k"], "'k' is not one of 'nes', 'all'"),
        (["structure", "show", "nowhere.toml"], "nowhere.toml"),
        (["guess"], "No such command 'guess'. Try: linkwise --help"),
        (["structure", "bnes", "--doff", "2"], "? Try: linkwise structure bnes --help"),
        (["--frobnicate"], "No such option"),
    ],
)
def test_wrong_usage_is_one_paragraph_and_exit_code_2(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(arguments) == 2
    out, err = capsys.readouterr()
    assert out == "" and message in err
    assert err.startswith("linkwise: ") and "Traceback" not in err and "\n\n" not in err


def test_debug_shows_the_traceback(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "bnes", "--dof", "3", "--debug"]) == 2
    err = capsys.readouterr().err
    assert "Traceback" in err and "linkwise: the number of masses must be even" in err


def test_a_fault_of_linkwise_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(lw, "bnes_chain", lambda n: 1 / 0)
    assert run(["structure", "bnes", "--dof", "2"]) == 1
    assert "internal error of linkwise: ZeroDivisionError" in capsys.readouterr().err


def test_interrupt_is_no_traceback(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupted(n: int) -> lw.Structure:
        raise KeyboardInterrupt

    monkeypatch.setattr(lw, "bnes_chain", interrupted)
    assert run(["structure", "bnes", "--dof", "2"]) == 130
    assert capsys.readouterr().err.strip().startswith("linkwise: interrupted")


@pytest.mark.parametrize("place", ["a folder", "below a file"])
def test_a_place_that_cannot_be_written_is_named(
    place: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("")
    target = tmp_path if place == "a folder" else tmp_path / "file" / "chain.toml"
    assert run(["structure", "bnes", "--dof", "2", "-o", str(target)]) == 2
    assert str(tmp_path) in capsys.readouterr().err


@pytest.mark.parametrize(
    "command",
    [[], *([name] for name in COMMANDS), *(["structure", name] for name in structure_commands.commands)],
)
def test_every_help_has_an_example(command: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run([*command, "--help"]) == 0
    example = re.split("Examples?:\n", capsys.readouterr().out)[-1]
    assert example.strip().startswith(" ".join(["linkwise", *command]))


def commands_with_help() -> Iterator[click.Command]:
    """All commands, those of groups too."""
    yield linkwise
    for name in COMMANDS:
        command = linkwise.commands[name]
        yield command
        yield from command.commands.values() if isinstance(command, click.Group) else ()


def examples() -> list[str]:
    """The lines of help that are commands, those that go on put together."""
    lines = [
        line.strip()
        for command in commands_with_help()
        for line in (command.help or "").replace("\\\n", " ").splitlines()
    ]
    return [line for line in lines if line.startswith("linkwise ")]


def test_every_example_of_help_is_right_usage() -> None:
    """Parsed and not run: --hum x:m2=50 was refused for want of a unit."""
    texts = examples()
    assert len(texts) > 50
    for text in texts:
        words = shlex.split(text)[1:]
        command: click.Command = linkwise
        while isinstance(command, click.Group):
            command = command.commands[words.pop(0)]
        command.make_context(command.name, words)
    with pytest.raises(click.UsageError, match="loud"):
        linkwise.commands["identify"].make_context("identify", ["a.csv", "b.toml", "--hum", "x:m1=loud"])


def test_a_reader_that_goes_away_is_no_error() -> None:
    """`linkwise ... | head -1` closes the pipe early."""
    command = f"{sys.executable} -m linkwise structure bnes --dof 1000 | head -1"
    result = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert result.stdout.startswith("name = ") and result.stderr == ""


def test_version_is_that_of_the_package(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["--version"]) == 0
    assert lw.__version__ in capsys.readouterr().out


def test_named_laws_are_listed_and_printed_as_links_to_edit(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["structure", "laws"]) == 0
    listed = capsys.readouterr().out
    assert "iwan(6): sliders in parallel" in listed and "z' = (v - s*abs(v)*z" in listed
    assert run(["structure", "laws", "iwan(2)"]) == 0
    table = capsys.readouterr().out
    masses = "".join(f'[[mass]]\nname = "{name}"\nmass = 1.0\n' for name in ("m1", "m2"))
    assert lw.parse_structure(masses + table).link("iwan").law.states == ("u1", "u2", "ub")
    assert 'on a rig "base" and "ground"' in table
    on_rig = table.replace('between = ["m2", "m1"]', 'between = ["base", "ground"]')
    assert lw.parse_structure(on_rig).on_rig
    assert run(["structure", "laws", "piezo", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)["piezo"]
    assert document["states"]["V"] == {"rate": "(-theta*v - V/R)/C", "unit": "V"}
    assert document["coefficients"]["theta"]["unit"] == "N/V"
    assert run(["structure", "laws", "bouc"]) == 2
    assert "unknown law 'bouc'" in capsys.readouterr().err


def test_show_tells_states(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    values = dict.fromkeys(lw.model.named_law("coil").coefficients, 2.0)
    rig = structure({"m1": 1.0}, named("coil", "m1-ground", "coil", **values))
    lw.write_structure(rig, tmp_path / "rig.toml")
    assert run(["structure", "show", str(tmp_path / "rig.toml")]) == 0
    out = capsys.readouterr().out
    assert "i' = (g*v - R*i)/L; i in A, 0 at the start" in out
    assert "equilibria and modes are not shown: link coil has memory" in out
