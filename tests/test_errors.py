"""What the errors say and carry."""

import pickle

import pytest

from linkwise.errors import (
    IdentificationError,
    LawError,
    LinkwiseError,
    RecordError,
    SimulationError,
    StructureError,
)


def test_law_error_puts_the_caret_under_the_place() -> None:
    error = LawError("'foo' is not a function.", "k*d + foo(v)", 6, "Use one of abs, sign.")
    assert str(error) == "'foo' is not a function.\n  k*d + foo(v)\n        ^\nUse one of abs, sign."
    lines = str(LawError("no", "k*d +\n\tfoo(d)", 7)).splitlines()
    assert lines[1:] == ["   foo(d)", "   ^"]  # the line of the place only
    assert "^" not in str(LawError("no", "k*d"))


def test_law_error_cuts_a_long_text_and_keeps_the_caret_right() -> None:
    text = "k*d + " * 200 + "foo(d)" + " + k*d" * 200
    quoted, caret = str(LawError("no", text, text.index("foo"))).splitlines()[1:3]
    assert len(quoted) < 90
    assert quoted.startswith("  ...") and quoted.endswith("...")
    assert quoted[caret.index("^") :].startswith("foo(d)")
    assert str(LawError("no", "k" * 100)).endswith("...")


@pytest.mark.parametrize(
    ("error", "text"),
    [
        (RecordError("no", file="a.csv", line=3, channel="x:m1"), "a.csv, line 3, channel x:m1: no"),
        (RecordError("no", channel="x:m1"), "channel x:m1: no"),
        (RecordError("no"), "no"),
        (StructureError("no", where="chain.toml"), "chain.toml: no"),
        (StructureError("no"), "no"),
        (SimulationError("x of m1 passed 1e9 m at 0.3 s", time=0.3, mass="m1"), "x of m1 passed 1e9 m at 0.3 s"),
    ],
)  # fmt: skip
def test_message_names_the_place(error: LinkwiseError, text: str) -> None:
    assert str(error) == text


@pytest.mark.parametrize(
    "error",
    [
        LawError("no", "k*d", 2, "do"),
        StructureError("no", where="a"),
        RecordError("no", "a", 1, "c"),
        SimulationError("no", 1.0, "m1"),
    ],
)
def test_errors_cross_process_borders(error: LinkwiseError) -> None:
    """Campaign workers send them back: a pickled error is equal in text and in what it carries."""
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error) and str(copy) == str(error) and vars(copy) == vars(error)


def test_exit_codes() -> None:
    codes = {kind: kind.exit_code for kind in (LawError, StructureError, RecordError)}
    assert set(codes.values()) == {2}
    assert {SimulationError.exit_code, IdentificationError.exit_code, LinkwiseError.exit_code} == {1}
