"""Every public function and constructor refuses arguments that make no sense with an error of linkwise, and never crashes.

Each is called as it should be and then, argument by argument, with values of other types, swapped ones and numbers that are
none. What it may do is take them or raise a `LinkwiseError`; a raw exception of Python or NumPy is a defect.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from contextlib import chdir, nullcontext
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from present import some
from problems import chain_record
from valid_calls import CHAIN, LINK, Call, answers, figures, records, structures

import linkwise as lw

pytestmark = [
    pytest.mark.filterwarnings("ignore::RuntimeWarning"),
    pytest.mark.filterwarnings("ignore:Conversion of an array:DeprecationWarning"),  # NumPy before 2
    pytest.mark.filterwarnings("ignore:linkwise.law_path is deprecated"),
    pytest.mark.usefixtures("unrendered"),
]


class Unexpected:
    """What nobody takes for anything else."""

    def __repr__(self) -> str:
        return "Unexpected()"


WRONG: tuple[Any, ...] = (
    None, "m1", "3.0", "", 3.0, -1.0, 0, -1, True, float("nan"), float("inf"), Unexpected(), lw.Record,
    [], {}, ["m1"], [Unexpected()], {"m1": None}, {"x:m1": Unexpected()}, {3: 3.0}, np.zeros((2, 2, 2)), np.array([np.nan]),
    CHAIN, LINK, Path("nowhere"),
)  # fmt: skip


def failures(call: Call) -> Iterator[str]:
    """What a call raises with one argument wrong, or two swapped, that is no error of linkwise."""
    names = list(call.arguments)
    swaps = [
        {first: call.arguments[second], second: call.arguments[first]} for first, second in pairwise(names)
    ]
    for changes in [*({name: value} for name in call.names for value in WRONG), *swaps]:
        try:
            call(**changes)
        except lw.LinkwiseError:
            continue
        except Exception as error:
            yield f"{changes}: {type(error).__name__}: {error}"


GROUPS = ("structures", "records", "answers", "figures")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where the calls read and write."""
    folder = tmp_path_factory.mktemp("calls")
    record = chain_record(2, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    lw.write_structure(CHAIN, folder / "chain.toml")
    lw.write_record(record, folder / "record.csv")
    (folder / "mapping.toml").write_text("rate = 500.0\n")
    (folder / "modes.csv").write_text("frequency[Hz],damping,tip\n5.2,0.01,0.62\n")
    for name in ("beam.mtx", "stiff.mtx"):
        (folder / name).write_text("%%MatrixMarket matrix coordinate real symmetric\n1 1 1\n1 1 2.0\n")
    return folder


@pytest.fixture(scope="module")
def calls(folder: Path, fitted: lw.Estimate, discovered: lw.Discovery) -> dict[str, dict[str, Call]]:
    """All calls, by group and name."""
    record = lw.read_record(folder / "record.csv")
    return {
        "structures": structures(), "records": records(record), "answers": answers(record, fitted, discovered),
        "figures": figures(record, fitted, discovered),
    }  # fmt: skip


NOT_FITTED = {
    "profile_interval": 'has none: use "ml"'
}  # calls of an estimate by the weak form, which it refuses


@pytest.mark.parametrize("group", GROUPS)
def test_wrong_arguments_are_refused_by_linkwise(
    group: str, calls: dict[str, dict[str, Call]], folder: Path
) -> None:
    with chdir(folder):
        for name, call in some(calls[group].items()):
            with (
                pytest.raises(lw.LinkwiseError, match=NOT_FITTED[name])
                if name in NOT_FITTED
                else nullcontext()
            ):
                call()
        raw = {name: errors for name, call in calls[group].items() if (errors := list(failures(call)))}
    assert raw == {}


def test_the_walk_sees_raw_exceptions() -> None:
    def careless(values: Any) -> float:
        return float(values[0])

    errors = list(failures(Call(careless, {"values": [1.0]})))
    assert any("TypeError" in error for error in errors) and any("IndexError" in error for error in errors)


def test_every_public_function_is_called(calls: dict[str, dict[str, Call]]) -> None:
    """Those left out read folders of studies, or take what others do: `discover` what `check_discovery` takes."""
    called = {name.partition(" ")[0] for group in calls.values() for name in group}
    functions = {name for name in lw.__all__ if inspect.isfunction(getattr(lw, name))}
    left_out = {
        "discover", "export_study", "read_posterior", "read_rows", "read_study", "run_study", "stored_study", "study_summary",
        "success_maps", "write_absorption_map", "write_study_report",
    }  # fmt: skip
    assert functions - called == left_out


def test_an_error_names_the_argument_what_was_expected_and_the_next_step() -> None:
    with pytest.raises(lw.ArgumentTypeError) as error:
        lw.simulate(CHAIN, duration="3.0", rate=100.0)  # type: ignore[arg-type]
    assert (
        str(error.value)
        == "simulate(structure): duration must be of type float or None, got '3.0'; write it without quotes"
    )
    with pytest.raises(
        lw.ArgumentTypeError, match=r"sensors must be of type sequence of str, got 'x:m1'; put it in a list"
    ):
        lw.simulate(CHAIN, duration=1.0, rate=100.0, sensors="x:m1")
    with pytest.raises(lw.ArgumentTypeError, match=r"argument 'relase'; did you mean \"release\"\?"):
        lw.simulate(CHAIN, duration=1.0, rate=100.0, relase={"v:m1": 1.0})  # type: ignore[call-arg]
    with pytest.raises(lw.ArgumentTypeError, match=r"^limit\(structure\): noise is missing$"):
        lw.limit(CHAIN, duration=1.0, rate=100.0)  # type: ignore[call-arg]
    with pytest.raises(lw.ArgumentTypeError, match=r"release\['v:m1'\] must be of type float, got None"):
        lw.orbit_envelope(CHAIN, {"v:m1": None}, duration=1.0, rate=100.0)  # type: ignore[dict-item]
    with pytest.raises(lw.ArgumentTypeError, match=r"d_range must have 2 entries, got 3"):
        lw.plot.force_errors(LINK, {"weak": LINK}, (0.0, 1.0, 2.0))  # type: ignore[arg-type]
