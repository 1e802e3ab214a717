"""Main arguments of another type, or swapped, are refused with the order that a function takes them in."""

from __future__ import annotations

import inspect
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from problems import chain_record

import linkwise as lw
from linkwise.argument_types import check_type, checked

CHAIN = lw.bnes_chain(2)
KNOWN = lw.Coefficient.number(1.0)
LAW = lw.Law.parse("k*d")


@pytest.mark.parametrize(
    ("function", "first", "second"),
    [
        (lw.identify, CHAIN, "record"),
        (lw.discover, {"m1": 1.0}, "record"),
        (lw.check_discovery, {"m1": 1.0}, "record"),
        (lw.validate, CHAIN, "record"),
        (lw.identify_host, CHAIN, None),
        (lw.inspect, CHAIN, None),
        (lw.compare_levels, CHAIN, None),
    ],
)
def test_what_is_no_record_is_refused(function: Callable[..., Any], first: Any, second: str | None) -> None:
    name, *names = inspect.signature(function).parameters
    call = f"{function.__name__}({name}, {names[0]})" if second else f"{function.__name__}({name})"
    others = () if second is None else (first,)
    kind = type(first).__name__
    expected = {lw.validate: "Record", lw.compare_levels: "sequence of Record"}.get(
        function, "Record or sequence of Record"
    )
    with pytest.raises(TypeError) as error:
        function(first, *others)
    assert str(error.value) == f"{call}: {name} must be of type {expected}, got {kind}"
    with pytest.raises(TypeError) as error:
        function("run.csv", *others)
    advice = "; read_record(path) reads one from a file" if expected.startswith("Record") else ""
    assert str(error.value) == f"{call}: {name} must be of type {expected}, got 'run.csv'{advice}"


@pytest.mark.parametrize(
    ("function", "arguments", "message"),
    [
        (lw.modes, (CHAIN.links[0],), r"modes\(structure\): structure must be of type Structure, got Link"),
        (lw.equilibria, (CHAIN.links[0],), r"equilibria\(structure\): structure must be"),
        (lw.nmse, (CHAIN, CHAIN, None), "true must be of type Link, got Structure"),
        (lw.nmse, (CHAIN.links[0], CHAIN.links[1], CHAIN), "record must be of type Record, got Structure"),
        (lw.write_result, (Path("answer"), "fit"), "estimate must be of type Estimate, got"),
        (lw.write_record, ("run.csv", "run.csv"), "record must be of type Record, got 'run.csv'"),
        (lw.write_structure, ("a.toml", "a.toml"), "structure must be of type Structure, got 'a.toml'"),
    ],
)
def test_other_functions_say_what_they_take(
    function: Callable[..., object], arguments: tuple[Any, ...], message: str
) -> None:
    with pytest.raises(TypeError, match=message):
        function(*arguments)


@pytest.mark.parametrize(
    ("function", "options"),
    [
        (lw.simulate, {"duration": 1.0, "rate": 100.0}),
        (lw.limit, {"duration": 1.0, "rate": 100.0, "noise": 20.0}),
        (lw.absorb, {"duration": 1.0}),
        (lw.absorption_map, {"over": {"nes1.alpha": [-100.0]}, "duration": 1.0}),
        (lw.absorption_intervals, {"duration": 1.0}),
    ],
)
def test_what_is_no_structure_is_refused(function: Callable[..., Any], options: dict[str, Any]) -> None:
    record = chain_record(2)
    with pytest.raises(TypeError, match=rf"^{function.__name__}\((structure|identified).* must be of type"):
        function(record, **options)


def test_the_second_argument_and_every_record_are_read() -> None:
    record = chain_record(2)
    with pytest.raises(
        TypeError, match=r"records\[1\] must be of type Record, got PosixPath\('b\.csv'\); read_record"
    ):
        lw.inspect([record, Path("b.csv")])  # type: ignore[list-item]
    with pytest.raises(TypeError, match=r"structure must be of type Structure, got Record$"):
        lw.identify(record, record)  # type: ignore[arg-type]
    with pytest.raises(
        TypeError, match=r"masses must be of type Mapping, Structure or PartialStructure, got list"
    ):
        lw.discover(record, ["m1", "m2"])  # type: ignore[arg-type]
    with pytest.raises(
        TypeError, match=r"answer must be of type Structure, Estimate, Posterior, str or Path, got 3$"
    ):
        lw.validate(record, 3)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match=r"method must be of type str or Estimator, got WeakForm"):
        lw.identify(record, CHAIN.unknown("nes"), method=lw.WeakForm)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("between", "law", "coefficients", "message"),
    [
        (("m1", "ground"), "k*d", {"k": KNOWN}, "law must be of type Law, got 'k*d'; Law.parse(text) makes one of a text"),
        (("m1", "ground"), LAW, {"k": None}, "k must be of type Coefficient or float, got NoneType"),
        (("m1", "ground"), LAW, {"k": "unknown"}, "got 'unknown'; Coefficient.unknown() makes one to be identified"),
        ("m1", LAW, {"k": KNOWN}, "between must be of type tuple or list, got 'm1'"),
    ],
)  # fmt: skip
def test_the_parts_of_a_link_are_read(between: Any, law: Any, coefficients: Any, message: str) -> None:
    with pytest.raises(TypeError) as error:
        lw.Link("spring", between, law, coefficients)
    assert str(error.value).startswith('link "spring": ') and message in str(error.value)


def test_a_number_stands_for_a_known_coefficient() -> None:
    two = lw.Coefficient.number(2.0)
    link = lw.Link("spring", ("m1", "ground"), LAW, {"k": 2.0})
    mode = lw.HostMode(2, np.float64(2.0), {"tip": 1.0})
    assert (
        lw.Mass("m1", np.float64(2.0)).mass == link.coefficients["k"] == mode.frequency == mode.damping == two
    )
    assert lw.named_law("jenkins").link("joint", ("m1", "ground"), {"k": 2.0}).coefficients["k"] == two
    assert replace(link, name="other").coefficients == link.coefficients


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: lw.Mass("m1", np.nan), 'mass "m1"'),
        (lambda: lw.Mass("m1", -1.0), "the mass must be positive"),
        (lambda: lw.Link("a", ("m1", "ground"), LAW, {"k": np.inf}), 'link "a", coefficient k'),
        (lambda: lw.HostMode(np.nan, 0.01, {"tip": 1.0}), "the frequency of a mode"),
        (lambda: lw.named_law("jenkins").link("a", ("m1", "ground"), {"k": np.nan}), 'link "a", coefficient k'),
    ],
)  # fmt: skip
def test_a_number_that_is_none_is_refused_by_its_place(build: Callable[[], object], message: str) -> None:
    with pytest.raises(lw.StructureError, match=message):
        build()


def test_what_has_its_type_passes() -> None:
    check_type("f(x)", "x", CHAIN, lw.Record, lw.Structure)
    assert len(lw.inspect(iter([chain_record(2)])).channels) == 2  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("accepted", "refused", "message"),
    [
        ({"k": 1.0}, {"k": "1.0"}, r"values\['k'\] must be of type array of numbers, got '1.0'"),
        ({"k": 1.0}, {3: 1.0}, "a key of values must be of type str, got 3"),
        ({"k": np.zeros(20)}, {"k": np.full(20, "1")}, r"values\['k'\] must be of type array of numbers"),
    ],
)
def test_what_was_accepted_before_lets_nothing_else_pass(accepted: Any, refused: Any, message: str) -> None:
    for _ in range(2):
        assert np.all(LAW.force(0.0, 0.0, accepted) == 0.0)
    with pytest.raises(lw.ArgumentTypeError, match=message):
        LAW.force(0.0, 0.0, refused)


def test_the_length_of_a_short_sequence_is_looked_at_each_time() -> None:
    @checked
    def middle(ends: tuple[float, float]) -> float:
        return 0.5 * sum(ends)

    assert middle(np.array([1.0, 3.0])) == 2.0  # type: ignore[arg-type]
    for length in (3, 30):
        with pytest.raises(lw.ArgumentTypeError, match=f"ends must have 2 entries, got {length}"):
            middle(np.ones(length))  # type: ignore[arg-type]
