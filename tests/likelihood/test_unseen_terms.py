"""Terms that no test of the records would show, though they would move coefficients out of their intervals, are told."""

from __future__ import annotations

import json

import numpy as np
import pytest
from present import present
from random_force import random_force
from structures import oscillator

import linkwise as lw

RATE = 200.0
LAW = "k*d + c*v + k3*d**3"
K, C, K3 = 987.0, 6.0, 4e5
TRUE = oscillator(LAW, k=K, c=C, k3=K3)
NOISE = 0.00012  # m, 40 dB
SEED = 41  # of the noise; that of the force is another


def record(
    truth: lw.Structure, *, duration: float = 10.0, noise: float = NOISE, rms: float = 6.0
) -> lw.Record:
    """The oscillator under a random force from 1 to 12 Hz, which is the same for every structure."""
    forces = {"m1": random_force(np.random.default_rng(SEED + 1), duration, RATE, rms=rms)}
    clean = lw.simulate(truth, forces=forces, duration=duration, rate=RATE)
    x = clean.channel("x:m1") + noise * np.random.default_rng(SEED).standard_normal(len(clean))
    return lw.Record.from_arrays(clean.time, {"x:m1": x, "force:m1": clean.channel("force:m1")})


def told(fit: lw.Estimate) -> str:
    """The sentence on them, empty without one."""
    start = "The records do not rule out a force"
    return " ".join(finding for finding in fit.findings if finding.startswith(start))


def quintic_of(fit: lw.Estimate) -> lw.estimates.UnseenTerm | None:
    return next((term for term in fit.unseen_terms if term.term == "d**5"), None)


def bent_by(share: float, seen: lw.Record) -> lw.Structure:
    """The oscillator with a quintic term that makes a `share` of the force in its link along the motion that was seen."""
    x = seen.channel("x:m1")
    force = K * x + K3 * x**3
    return oscillator(f"{LAW} + q*d**5", k=K, c=C, k3=K3, q=share * force.std() / np.sqrt(np.mean(x**10)))


def test_a_term_within_the_limit_is_not_seen_and_moves_the_coefficient_as_far_as_told() -> None:
    noise, unknown = 3.0 * NOISE, TRUE.unknown("all")
    seen = record(TRUE, noise=noise)
    fit = lw.identify(seen, unknown)
    term = present(quintic_of(fit))
    assert (term.link, term.coefficient) == ("link", "link.k3")
    assert 0.001 < term.share < 0.01 and term.standard_errors > 3.0 and term.relative_change > 0.01
    lacking = lw.identify(record(bent_by(0.5 * term.share, seen), noise=noise), unknown)
    assert lacking.verdicts == (
        lw.Verdict.CONVERGED,
    )  # trusted, and k3 is several of its standard errors off
    k3 = lacking.coefficient("link.k3")
    assert k3.value - K3 > 4.0 * present(k3.standard_error)
    moved = k3.value - fit.coefficient("link.k3").value
    # the first order, of a law that changes by 3 %: its square, and the motion that the share is taken along, are neglected
    assert moved == pytest.approx(0.5 * abs(term.change), rel=0.1)
    assert "a force like d**5 in link" in told(lacking) and "link.k3" in told(lacking)


def test_records_that_bound_the_terms_tell_nothing() -> None:
    unknown = TRUE.unknown("all")
    for bounding in (record(TRUE, duration=60.0), record(TRUE, noise=0.1 * NOISE)):
        fit = lw.identify(bounding, unknown)
        assert fit.verdicts == (lw.Verdict.CONVERGED,)
        assert fit.unseen_terms == () and not told(fit)
        assert fit.to_dict()["unseen_terms"] == []


def test_a_term_that_is_in_the_law_or_that_the_record_shows_is_no_unseen_one() -> None:
    seen = record(TRUE)
    with_it = oscillator(f"{LAW} + q*d**5", k=K, c=C, k3=K3, q=0.0).unknown("all")
    assert quintic_of(lw.identify(seen, with_it)) is None
    shown = lw.identify(record(bent_by(0.02, seen)), TRUE.unknown("all"))
    assert lw.Verdict.CONVERGED not in shown.verdicts and shown.diagnosis[0].term == "d**5"
    assert shown.unseen_terms == () and not told(shown)


def test_the_answer_lists_them_all_and_tells_three_coefficients() -> None:
    fit = lw.identify(record(TRUE, noise=10.0 * NOISE), TRUE.unknown("all"))
    terms = [term for term in fit.unseen_terms if not term.is_mass]
    assert len(terms) > len({term.coefficient for term in terms}) > 1
    assert [term.standard_errors for term in terms] == sorted(
        (t.standard_errors for t in terms), reverse=True
    )
    documents = json.loads(json.dumps(fit.to_dict()))["unseen_terms"]
    documents = [document for document in documents if document["term"] != "mass"]
    assert [document["term"] for document in documents] == [term.term for term in terms]
    assert documents[0]["message"] == terms[0].description
    assert documents[0]["share_percent"] == 100.0 * terms[0].share
    told_ones = {term.coefficient: term for term in reversed(terms)}.values()
    assert all(term.description in told(fit) for term in told_ones)
    assert f"In all, {len(terms)} such terms" in told(fit)
    assert told(fit) in " ".join(str(fit).replace("\n  ", " ").split()).replace("! ", "")
