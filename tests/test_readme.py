"""The README tells the truth: its code runs and prints what stands below it, its commands are there."""

import contextlib
import io
import re
import shlex
from pathlib import Path

import pytest

from linkwise.cli import linkwise, run

TOP = Path(__file__).resolve().parents[1]
README = (TOP / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```", README, flags=re.MULTILINE | re.DOTALL)
NUMBER = re.compile(r"[-+]?\d+(?:\.(\d*))?(?:e([-+]?\d+))?")
SECONDS = re.compile(r"[\d.]+ s\b")


def blocks(language: str) -> list[str]:
    """The README's code blocks in a language."""
    return [text for name, text in BLOCKS if name == language]


def places(text: str) -> list[tuple[float, float]]:
    """Each number in a text and what one unit in its last printed place is worth."""
    numbers = []
    for match in NUMBER.finditer(text):
        decimals, exponent = len(match[1] or ""), int(match[2] or 0)
        numbers.append((float(match[0]), 10.0 ** (exponent - decimals)))
    return numbers


def agree(printed: str, promised: str) -> bool:
    """Equal words, and numbers equal but for their last printed place (rounding); how long it took may differ."""
    printed, promised = SECONDS.sub("0 s", printed.strip()), SECONDS.sub("0 s", promised.strip())
    if NUMBER.sub("#", printed).split() != NUMBER.sub("#", promised).split():
        return False
    pairs = zip(places(printed), places(promised), strict=True)
    return all(
        abs(value - value_promised) <= 1.01 * max(unit, unit_other)
        for (value, unit), (value_promised, unit_other) in pairs
    )


def test_example_prints_what_stands_below_it() -> None:
    [code], [promised] = blocks("python"), blocks("text")
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(code, "README.md", "exec"), {})
    assert agree(printed.getvalue(), promised), printed.getvalue()


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_commands_run_as_they_stand(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lines = [line for block in blocks("sh") for line in block.splitlines() if line.startswith("linkwise ")]
    assert [run(shlex.split(line)[1:]) for line in lines] == [0] * len(lines) and lines
    assert (tmp_path / "answer" / "report.html").exists() and (tmp_path / "found" / "graph.png").exists()


@pytest.mark.parametrize(
    ("printed", "promised", "equal"),
    [
        ("a 1.50 N in 0.2 s", "a 1.51 N in 3 s", True),
        ("a 1.50 N", "a 1.52 N", False),
        ("a 1.50 N", "a 1.50 kN", False),
        ("beta 1.0e+06", "beta 1.1e+06", True),
        ("beta 1.0e+06", "beta 1.2e+06", False),
        ("converged", "not converged", False),
    ],
)
def test_the_comparison_can_fail(printed: str, promised: str, equal: bool) -> None:
    assert agree(printed, promised) is equal


def test_example_is_twelve_lines_at_most() -> None:
    assert len(blocks("python")[0].strip().splitlines()) <= 12


def test_make_targets_and_commands_are_there() -> None:
    targets = set(
        re.findall(r"^([a-z]+):", (TOP / "Makefile").read_text(encoding="utf-8"), flags=re.MULTILINE)
    )
    named = set(re.findall(r"\bmake ([a-z]+)", README))
    assert {"identify", "test"} <= named <= targets
    assert set(re.findall(r"\blinkwise ([a-z]+) ", "\n".join(blocks("sh")))) <= set(linkwise.commands)


def test_links_and_pictures_are_there() -> None:
    local = [target for target in re.findall(r"\]\(([^)#]+)\)", README) if "://" not in target]
    assert local and [target for target in local if not (TOP / target).exists()] == []
