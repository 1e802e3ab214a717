"""Records with one fault of a laboratory each, nothing stated: whether it is named first, and what is trusted beside it.

A fault that hardly raises the likelihood need not be named; what is trusted must be right in either case. LINKWISE_SEEDS says
how many records of each kind (default 20; 40 are asked, 100 of machines), or which of them, as 20:40, to run it in parts.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np
import pytest
from laboratory_records import SMALL, Faulty, asymmetric_well, of_sensor, with_machine, with_small_fault

import linkwise as lw
from linkwise.errors import LinkwiseError

_start, _, _stop = os.environ.get("LINKWISE_SEEDS", "20").rpartition(":")
FIRST = 494_000  # seeds from here on were never looked at
SEEDS = range(FIRST + int(_start or "0"), FIRST + int(_stop))
FAR = 4.5  # standard errors; of machines 4
TOLD = 15.0  # of -2 log likelihood: what a fault raises that has to be named
NAMED = 0.9
_NEAR = 0.02  # relative: of a frequency


@dataclass(frozen=True)
class Told:
    """What an answer says of a fault: its `gain`, whether it is named `first`, trusted, `far` off, and whether that with the
    fault taken in, by itself or as a second answer, is `right`.
    """

    gain: float
    first: bool
    trusted: bool
    far: float
    right: bool
    said: str


def told(case: Faulty) -> Told:
    """Identify a faulty record as its user would."""
    try:
        fit = lw.identify(case.record, case.asked)
    except LinkwiseError as error:
        return Told(np.inf, False, False, 0.0, False, f"refused: {error}"[:90])
    # which all of these records have as well
    causes = [cause for cause in (*fit.added, *fit.diagnosis) if cause.kind != "input noise"]
    far = float(np.abs(case.errors(fit)).max()) if fit.trusted else 0.0
    beside = fit if fit.trusted else fit.alternative
    right = beside is not None and float(np.abs(case.errors(beside)).max()) <= FAR
    gain = max((cause.gain for cause in causes), default=0.0 if fit.trusted else np.inf)
    named = bool(causes) and case.names(causes[0])
    if case.fault == "clock" and fit.trusted and causes and causes[0].kind.endswith("delay"):
        gain = 0.0  # beside half of the final slip as a delay it raises nothing
    said = f"{fit.verdicts[0].name} {[(cause.kind, cause.where, cause.term, round(cause.size, 4)) for cause in causes[:2]]}"
    return Told(gain, named, fit.trusted, far, right, said)


def reported(kind: str, make: object, far: float) -> tuple[float, int]:
    """The share of faults that are named first among those that raise the likelihood, and how many answers are wrong."""
    named, raised, wrong, trusted, right = 0, 0, 0, 0, 0
    print(f"\n{kind}")
    for seed in SEEDS:
        case = make(seed)  # type: ignore[operator]
        answer = told(case)
        raised += answer.gain > TOLD
        named += answer.gain > TOLD and answer.first
        trusted += answer.trusted
        right += answer.right and answer.gain > TOLD
        wrong += answer.far > far
        mark = "WRONG" if answer.far > far else "" if answer.first or answer.gain <= TOLD else "unnamed"
        print(f"  {seed} {case.where} {case.size:.4g} {answer.far:.1f} {answer.said} {mark}", flush=True)
    print(
        f"  named first {named} of {raised} that raise it, {right} right once taken in, {trusted} of {len(SEEDS)} trusted, "
        f"{wrong} wrong"
    )
    return named / max(raised, 1), wrong


@pytest.mark.parametrize("kind", ["high pass", "clock", "sign", "swapped", "unit"])
def test_an_error_of_a_channel_is_named_first(kind: str) -> None:
    share, wrong = reported(kind, lambda seed: of_sensor(kind, seed), FAR)
    assert share >= NAMED and wrong == 0


def test_a_machine_that_was_not_recorded_is_named() -> None:
    share, wrong = reported("machine", with_machine, 4.0)
    assert share >= NAMED and wrong <= 0.01 * len(SEEDS)


def test_an_asymmetric_well_is_not_trusted_beyond() -> None:
    _, wrong = reported("asymmetric well", asymmetric_well, FAR)
    assert wrong == 0


@pytest.mark.parametrize("kind", SMALL)
def test_what_is_trusted_beside_a_small_fault_is_right(kind: str) -> None:
    """But for a gain that drifts in a single decaying channel, which is damping to the first order."""
    _, wrong = reported(kind, lambda seed: with_small_fault(kind, seed), FAR)
    assert wrong <= (0.1 * len(SEEDS) if kind == "gain drift" else 0)
