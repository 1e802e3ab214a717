"""A few inputs of chance in every run of the tests, and the checks that look at what comes of them."""

import os
import signal
import sys
from multiprocessing.connection import Connection

import pytest

from fuzz import pool
from fuzz.case import Case, Kind, Outcome, complaints
from fuzz.cases import make_case

INPUTS = 25  # all families and kinds; `make fuzz` throws 10 000


def test_nothing_that_must_not_comes_of_a_few_inputs() -> None:
    wrong = {}
    for seed, outcome in pool.outcomes(range(INPUTS), 1):
        if faults := complaints(make_case(seed), outcome):
            wrong[seed] = faults
    assert wrong == {}


def test_an_input_depends_on_its_seed_alone() -> None:
    assert make_case(7) == make_case(7)
    assert len({repr(make_case(seed)) for seed in range(50)}) == 50
    families = {"law", "structure", "record", "mapping", "answer", "study", "option"}
    assert {make_case(seed).family for seed in range(200)} == families


COMMAND = Case(0, "option", Kind.COMMAND, ("structure", "bnes", "--dof", "2", "--json"))


@pytest.mark.parametrize(
    ("outcome", "faults"),
    [
        (Outcome(0, "{}"), []),
        (Outcome(2, "", "linkwise: no such file"), []),
        (Outcome(None, died="hangs"), ["hangs"]),
        (Outcome(None, error="Traceback\nValueError: x"), ["raised ValueError: x"]),
        (Outcome(1, "", "linkwise: internal error of linkwise"), ["says 'internal error'"]),
        (Outcome(2), ["fails without a word"]),
        (Outcome(7, "", "x"), ["ends with code 7"]),
        (Outcome(2, "", "x" * 4001), ["has a message of 4001 characters"]),
        (Outcome(0, "no json"), ["prints something that is not JSON"]),
        (Outcome(0, lost=("x:m1",)), ["loses x:m1 in silence"]),
        (Outcome(0, written=b"a log"), ["writes b'a log' to standard output past the command"]),
    ],
)
def test_what_must_not_come_is_noticed(outcome: Outcome, faults: list[str]) -> None:
    assert complaints(COMMAND, outcome) == faults


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no signals there")
def test_deaths_and_hangs_are_noticed_and_the_rest_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pool, "work", _dying)
    by_seed = dict(pool.outcomes(range(4), 2))
    assert by_seed[0].died == f"died with code {-signal.SIGSEGV}" and by_seed[2].died == "hangs"
    assert by_seed[1].code == by_seed[3].code == 0


def _dying(connection: Connection) -> None:
    """A worker that dies of seed 0 and hangs at seed 2."""
    while (seed := connection.recv()) is not None:
        if seed == 0:
            os.kill(os.getpid(), signal.SIGSEGV)
        if seed == 2:
            os.kill(os.getpid(), signal.SIGXCPU)
        connection.send(Outcome(0))
