"""Laws that lack a term: intervals hold what it makes of the coefficients, or it is told and takes trust away."""

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from present import present, some
from problems import truth
from random_signals import random_force
from record_faults import changed
from structures import link, named, oscillator, with_links

import linkwise as lw

pytestmark = pytest.mark.slow


RATE, DURATION = 200.0, 20.0
LAW = "k*d + c*v + k3*d**3"
TRUE, DAMPED = (oscillator(LAW, k=987.0, c=c, k3=4e5) for c in (2.0, 6.0))
NEEDED, EXACT = lw.Verdict.MODEL_ERROR_NEEDED, lw.Verdict.CONVERGED
CHANCE = 3.3  # standard errors that a normal estimate is off once in 1000


def record(structure: lw.Structure, seed: int) -> lw.Record:
    """The structure under a random force of 6 N root mean square from 1 to 12 Hz, at 40 dB."""
    forces = {"m1": random_force(np.random.default_rng(seed), DURATION, RATE)}
    return lw.simulate(structure, forces=forces, duration=DURATION, rate=RATE).with_noise(40.0, seed=seed)


def assert_held(fit: lw.Estimate, true: lw.Structure, moved: str = "", times: float = 1.0) -> None:
    """By their intervals, coefficients are off by chance; without what terms add `moved` is not, by so many times."""
    off, covariance = np.abs(fit.values - truth(true, fit.given_structure)), np.asarray(fit.covariance)
    assert np.all(off < CHANCE * np.sqrt(covariance.diagonal()))
    if moved:
        number = [str(parameter.name) for parameter in fit.parameters].index(moved)
        alone = covariance - present(fit.for_dropped_terms)
        assert off[number] > times * CHANCE * np.sqrt(alone[number, number])


def extra(law: str, **values: float) -> lw.Link:
    return link("extra", "m1-ground", law, **values)


DRAG = extra("q*v*abs(v)", q=0.5)
SLIP = named("extra", "m1-ground", "bouc-wen", k=0.0, c=0.0, F=0.13, x0=0.003, s=0.5)
RELAXATION = named("extra", "m1-ground", "maxwell", k=2.0, c=0.06)
HINT, MOST = "The residuals hint at a force like ", "Most of what is left would be explained by a force like "
LACKING = [  # a term, the verdict of laws without it, what is said, and the coefficient that was many standard errors off
    (TRUE, extra("q*d**5", q=2e7), 3, NEEDED, "With it, ", "link.k3", 1.0),
    (TRUE, DRAG, 3, NEEDED, "With it, ", "link.c", 1.0),
    (TRUE, extra("q*d**5", q=6e5), 7, EXACT, f"{HINT}d**5 in link", "link.k3", 3.0),
    (DAMPED, SLIP, 1, NEEDED, f"{MOST}hysteresis in link", "link.c", 2.0),
    (DAMPED, RELAXATION, 1, None, "", "link.c", 2.0),  # of 0.2 % of the force, which only scores show
]


@pytest.mark.parametrize(("asked", "term", "seed", "verdict", "said", "moved", "times"), LACKING)
def test_intervals_hold_what_a_missing_term_makes_of_the_coefficients(
    asked: lw.Structure,
    term: lw.Link,
    seed: int,
    verdict: lw.Verdict | None,
    said: str,
    moved: str,
    times: float,
) -> None:
    """Of laws that leave hardly more than noise; with a model error the answer is of the laws that come closest."""
    fit = lw.identify(record(with_links(asked, term), seed), asked.unknown("all"), as_stated=True)
    assert not fit.verdicts[0].forbids and verdict in (None, *fit.verdicts[:1])
    assert said in fit.message and (term is not SLIP or "such as bouc-wen" in fit.message)
    if fit.trusted:
        assert_held(fit, asked, moved, times)
        assert not fit.diagnosis
    if said == "With it, ":
        assert fit.diagnosis[0].shifted == moved
        with pytest.raises(lw.IdentificationError, match="does not allow for terms that are missing"):
            lw.likelihood.profile_interval(fit, moved)


def test_chance_hints_at_a_term_in_few_records_of_exact_laws() -> None:
    """Of a power in one record of 22, of two other usual terms in one of 80 each: more than one of six once in 16."""
    fits = [lw.identify(record(TRUE, seed), TRUE.unknown("all")) for seed in range(40, 46)]
    assert {fit.verdicts for fit in fits} == {(lw.Verdict.CONVERGED,)}
    assert sum(fit.for_dropped_terms is not None for fit in fits) <= 1


def test_a_term_that_hardly_raises_chi_square_is_told() -> None:
    """Coefficients of a chain of six masses were 11 standard errors off, and trusted: chi-square was within chance of 1."""
    chain = lw.bnes_chain(6)
    quintic = link("quintic", "-".join(chain.link("nes1").between), "q*d**5", q=1e7)
    clean = lw.simulate(with_links(chain, quintic), release={"v:m1": 3.0}, duration=4.0, rate=1000.0)
    asked = chain.unknown("all")
    fit = lw.identify(clean.with_noise(30.0, seed=5), asked, as_stated=True)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
    assert abs(present(fit.chi_square_per_sample) - 1.0) < 3.0 * np.sqrt(2.0 / fit.samples)
    assert (fit.diagnosis[0].where, fit.diagnosis[0].term) == ("nes1", "d**5")
    assert "Most of what is left would be explained by a force like d**5 in nes1" in fit.message
    assert fit.grade is lw.Grade.APPROXIMATE


K, C, K3 = 987.0, 6.0, 4e5
NOISE = 0.00012  # m, 40 dB
SEED = 41  # of the noise; that of the force is another


def shaken(
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
    noise, unknown = 3.0 * NOISE, DAMPED.unknown("all")
    seen = shaken(DAMPED, noise=noise)
    fit = lw.identify(seen, unknown)
    term = present(quintic_of(fit))
    assert (term.link, term.coefficient) == ("link", "link.k3")
    assert 0.001 < term.share < 0.01 and term.standard_errors > 3.0 and term.relative_change > 0.01
    lacking = lw.identify(shaken(bent_by(0.5 * term.share, seen), noise=noise), unknown)
    # trusted, and k3 is several of its standard errors off
    assert lacking.verdicts == (lw.Verdict.CONVERGED,)
    k3 = lacking.coefficient("link.k3")
    assert k3.value - K3 > 4.0 * present(k3.standard_error)
    moved = k3.value - fit.coefficient("link.k3").value
    # the first order, of a law that changes by 3 %: its square, and the motion that the share is taken along, are neglected
    assert moved == pytest.approx(0.5 * abs(term.change), rel=0.1)
    assert quintic_of(lacking) and "link.k3" in told(lacking)  # by d*abs(d), which changes it more


def test_a_stiffness_with_a_kink_that_no_test_sees_is_told() -> None:
    """Beside d and d**3 a force like d*abs(d) is hardly seen, and moves them by many standard errors."""
    stated = oscillator(LAW, k=987.0, c=2.0, k3=4e5)
    kinked = oscillator(f"{LAW} + q*d*abs(d)", k=987.0, c=2.0, k3=4e5, q=150.0)
    decay = lw.simulate(kinked, release={"x:m1": 0.03}, duration=4.0, rate=RATE)
    fit = lw.identify(decay.with_noise(35.0, seed=74), stated.unknown("all"))
    off = np.abs(fit.values - truth(stated, fit.given_structure)) / np.sqrt(fit.covariance.diagonal())
    told = next(term for term in fit.unseen_terms if term.term == "d*abs(d)")
    assert fit.trusted and CHANCE < off.max() < told.standard_errors


WELL = "alpha*d + beta*d**3 + c*v"
SINK: dict[str, Any] = {"alpha": -100.0, "beta": 1e6, "c": 0.3}  # wells at 10 mm


@pytest.mark.parametrize("q", [0.0, 300.0, 1000.0])  # 3 and 10 % of either force at a well
@pytest.mark.parametrize("level", [30.0, 40.0])
def test_intervals_in_one_well_hold_its_asymmetry(q: float, level: float) -> None:
    """Rest position and frequency are two facts: in one well, a symmetric law explains an asymmetric one to the noise."""
    truly, stated = oscillator(f"{WELL} + q*d**2", **SINK, q=q), oscillator(WELL, **SINK)
    within = lw.simulate(truly, release={"x:m1": 0.01, "v:m1": 0.03}, duration=6.0, rate=RATE)
    fit = lw.identify(within.with_noise(level, seed=int(q)), stated.unknown("all"))
    assert fit.trusted and "a force like d**2 in link, as of asymmetric wells" in fit.message
    assert_held(fit, stated)
    with_nothing = oscillator(f"{WELL} + q*d**2", **SINK, q=0.0).unknown("link.alpha", "link.beta", "link.c")
    exact = lw.identify(within.with_noise(level, seed=int(q)), with_nothing)
    assert exact.covariance[0, 0] < 0.01 * fit.covariance[0, 0]  # known to be symmetric


def test_motion_on_both_sides_of_a_sink_tells_its_asymmetry() -> None:
    across = lw.simulate(oscillator(WELL, **SINK), release={"v:m1": 0.5}, duration=6.0, rate=RATE)
    fit = lw.identify(across.with_noise(40.0, seed=3), oscillator(WELL, **SINK).unknown("all"))
    assert fit.trusted and "d**2" not in fit.message
    assert fit.covariance[0, 0] < 1.0


def test_intervals_hold_asymmetry_that_wells_hardly_crossed_do_not_tell() -> None:
    """A score of one standard error beside coefficients that are nine off."""
    sink: dict[str, Any] = {"alpha": -425.0, "beta": 6.7e6, "c": 0.57}
    truly, stated = oscillator(f"{WELL} + q*d**2", **sink, q=500.0), oscillator(WELL, **sink)
    crossed = lw.simulate(truly, release={"x:m1": 0.008, "v:m1": 0.22}, duration=5.6, rate=500.0)
    fit = lw.identify(crossed.with_noise(25.0, seed=2), stated.unknown("all"))
    assert fit.trusted and "a force like d**2 in link, as of asymmetric wells" in fit.message
    assert_held(fit, stated)


def test_a_term_nearly_as_likely_as_an_offset_is_named_beside_it() -> None:
    """Chance gives the term as much in one fit of some hundred; where one of the two is there, it may be that one."""
    across = lw.simulate(
        oscillator(WELL, **SINK), release={"x:m1": 0.01, "v:m1": 0.3}, duration=6.0, rate=250.0
    )
    noisy = across.with_noise(40.0, seed=2)
    off = lw.Record(noisy.start, noisy.rate, noisy.channels, noisy.values + 1e-5)
    offset, term = lw.identify(off, oscillator(WELL, **SINK).unknown("all"), as_stated=True).diagnosis
    assert (offset.kind, term.term) == ("offset", "d**2") and 0.0 < offset.gain - term.gain < 10.0
    assert term.gain < 16.0 < offset.gain


def test_records_that_bound_the_terms_tell_nothing() -> None:
    unknown = DAMPED.unknown("all")
    for bounding in (shaken(DAMPED, duration=60.0), shaken(DAMPED, noise=0.1 * NOISE)):
        fit = lw.identify(bounding, unknown)
        assert fit.verdicts == (lw.Verdict.CONVERGED,)
        assert fit.unseen_terms == () and not told(fit)
        assert fit.to_dict()["unseen_terms"] == []


def test_a_term_that_is_in_the_law_or_that_the_record_shows_is_no_unseen_one() -> None:
    seen = shaken(DAMPED)
    with_it = oscillator(f"{LAW} + q*d**5", k=K, c=C, k3=K3, q=0.0).unknown("all")
    assert quintic_of(lw.identify(seen, with_it)) is None
    shown = lw.identify(shaken(bent_by(0.02, seen)), DAMPED.unknown("all"))
    assert lw.Verdict.CONVERGED not in shown.verdicts and shown.diagnosis[0].term == "d**5"
    assert shown.unseen_terms == () and not told(shown)


def test_the_answer_lists_them_all_and_tells_three_coefficients() -> None:
    fit = lw.identify(shaken(DAMPED, noise=10.0 * NOISE), DAMPED.unknown("all"))
    terms = [term for term in fit.unseen_terms if not (term.is_mass or term.is_drift)]
    assert len(terms) > len({term.coefficient for term in terms}) > 1
    assert [term.standard_errors for term in terms] == sorted(
        (t.standard_errors for t in terms), reverse=True
    )
    documents = json.loads(json.dumps(fit.to_dict()))["unseen_terms"]
    documents = [document for document in documents if document["term"] not in ("mass", "gain drift")]
    assert [document["term"] for document in documents] == [term.term for term in terms]
    assert documents[0]["message"] == terms[0].description
    assert documents[0]["share_percent"] == 100.0 * terms[0].share
    told_ones = {term.coefficient: term for term in reversed(terms)}.values()
    assert all(term.description in told(fit) for term in told_ones)
    assert f"In all, {len(terms)} such terms" in told(fit)
    assert told(fit) in " ".join(str(fit).replace("\n  ", " ").split()).replace("! ", "")


FRICTION = 0.01  # N, beside 0.1 N of the damper at its fastest


@pytest.fixture(scope="module")
def rough_chain() -> lw.Record:
    """The two-mass chain with friction beside its bistable link."""
    rough = with_links(lw.bnes_chain(2), link("rough", "m2-m1", "mu*sign(v)", mu=FRICTION))
    return lw.simulate(rough, release={"v:m1": 1.0}, duration=2.0, rate=1000.0)


def test_friction_that_a_model_error_hides_takes_trust_away(rough_chain: lw.Record) -> None:
    """The damper stood for it, 6 to 8 standard errors off, and nothing was said."""
    chain = lw.bnes_chain(2)
    fit = lw.identify(rough_chain.with_noise(20.0, seed=0), chain.unknown("nes"), as_stated=True)
    number = [str(parameter.name) for parameter in fit.parameters].index("nes1.c")
    off = fit.values[number] - truth(chain, chain.unknown("nes"))[number]
    assert off > 5.0 * np.sqrt(fit.covariance[number, number])
    assert fit.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,) and fit.grade is not lw.Grade.EXPLAINED
    assert fit.diagnosis[0].term == "sign(v)" and fit.diagnosis[0].where == "nes1"
    assert fit.diagnosis[0].size == pytest.approx(FRICTION, rel=0.05)  # linearised at the fit without it
    assert "a force like sign(v) in nes1" in fit.message and "change nes1.c by" in fit.message


def test_forces_that_no_term_explains_remain_a_model_error() -> None:
    """White forces on both masses, which no channel shows, beside the motion after a release."""
    chain, rng = lw.bnes_chain(2), np.random.default_rng(0)
    forces = {
        mass: lw.model.Sampled(0.0, 1000.0, size * rng.normal(size=2001))
        for mass, size in (("m1", 5.0), ("m2", 0.05))
    }
    record = lw.simulate(chain, release={"v:m1": 1.0}, forces=forces, duration=2.0, rate=1000.0)
    fit = lw.identify(record.select(("x:m1", "x:m2")).with_noise(30.0, seed=0), chain.unknown("nes"))
    assert fit.model_error > 0.0 and fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)


MORE_DRAG = with_links(TRUE, extra("q*v*abs(v)", q=1.0))
PLAY = with_links(TRUE, extra("q*(max(d - 0.02, 0) + min(d + 0.02, 0))", q=100.0))
LONG, SEED_OF_ERRORS = 20.0, 31  # s
Change = Callable[[lw.Record], np.ndarray]


def late(seconds: float) -> Change:
    """The displacement shown late."""

    def shown(record: lw.Record) -> np.ndarray:
        signal = lw.model.Sampled(0.0, record.rate, record.channel("x:m1"), band_limited=True)
        return signal.value(np.clip(record.time - seconds, 0.0, record.time[-1]))

    return shown


def drifting(size: float) -> Change:
    """The displacement with a drift of `size` in m root mean square."""
    return lambda record: record.channel("x:m1") + size * np.sqrt(3.0) * np.linspace(-1.0, 1.0, len(record))


@cache
def shaken_for_long(structure: lw.Structure) -> lw.Record:
    """The motion of an oscillator under a random force from 1 to 12 Hz."""
    forces = {"m1": random_force(np.random.default_rng(SEED_OF_ERRORS), LONG, RATE)}
    return lw.simulate(structure, forces=forces, duration=LONG, rate=RATE)


def recorded(change: Change, structure: lw.Structure = PLAY) -> lw.Record:
    """The oscillator with a stop that its law lacks, 0.3 % of its force, or another `structure`, at 50 dB."""
    clean = shaken_for_long(structure)
    return changed(clean, x_m1=change(clean)).with_noise(50.0, seed=SEED_OF_ERRORS)


@pytest.mark.parametrize(
    ("change", "structure", "kind"), [(drifting(3e-4), PLAY, "drift"), (late(3e-4), MORE_DRAG, "term")]
)
def test_a_small_error_beside_a_missing_term_is_borne(
    change: Change, structure: lw.Structure, kind: str
) -> None:
    """It explains most of what is left, or less than a term; no coefficient moves by three standard errors."""
    fit = lw.identify(recorded(change, structure), TRUE.unknown("all"), as_stated=True)
    assert fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,) and fit.grade is lw.Grade.APPROXIMATE
    assert fit.diagnosis[0].kind.endswith(kind)
    if kind == "term":
        assert some(cause for cause in fit.diagnosis if cause.kind.endswith("delay"))
        return
    assert fit.diagnosis[0].is_instrument
    assert f"Most of what is left would be explained by {fit.diagnosis[0].description}" in fit.message
    assert all(cause.shift <= 3.0 for cause in some(cause for cause in fit.diagnosis if cause.is_instrument))


def noisier(record: lw.Record) -> np.ndarray:
    return 1.02 * record.channel("x:m1")


@pytest.mark.parametrize(("change", "structure"), [(late(2e-3), PLAY), (noisier, MORE_DRAG)])
def test_an_error_that_moves_a_coefficient_far_takes_trust(change: Change, structure: lw.Structure) -> None:
    """Where drag explains more than a gain of 2 %, k3 was 15 standard errors off and trusted."""
    fit = lw.identify(recorded(change, structure), TRUE.unknown("all"))
    assert not fit.trusted
    if structure is MORE_DRAG:
        assert fit.diagnosis[0].kind == "term" and fit.model_error > 0.0
        assert fit.grade is lw.Grade.APPROXIMATE
        assert some(cause for cause in fit.diagnosis if cause.kind == "gain")
        return
    off = fit.values - truth(TRUE, fit.given_structure)
    assert np.max(np.abs(off) / np.sqrt(np.asarray(fit.covariance).diagonal())) > CHANCE
    assert fit.diagnosis[0].is_instrument


@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_a_drift_that_passes_for_damping_is_told(drift: float) -> None:
    """A single sensor of a free decay: the damping of a linear spring and a drift of the gain have one envelope."""
    linear = oscillator("k*d + c*v", k=987.0, c=2.0)
    decay = lw.simulate(linear, release={"x:m1": 0.03}, duration=4.0, rate=RATE)
    drifting = replace(decay, values=decay.values * (1.0 + drift * decay.time[:, None] / 4.0), simulated=None)
    fit = lw.identify(drifting.with_noise(40.0, seed=1), linear.unknown("all"))
    told = next(term for term in fit.unseen_terms if term.is_drift)
    assert fit.trusted and (told.link, told.coefficient, told.share) == ("x:m1", "link.c", 0.05)
    # the rate of a gain that changes by a small part is that of an amplitude: c/(2 m)
    assert abs(told.change) == pytest.approx(2.0 * 0.05 / 4.0, rel=0.05)
    assert sum("passes for damping" in finding for finding in fit.findings) == 1
    moved = fit.coefficient("link.c").value - 2.0
    assert moved == pytest.approx(
        -2.0 * drift / 4.0, abs=4.0 * present(fit.coefficient("link.c").standard_error)
    )


@pytest.mark.parametrize("sensor", ["a", "x"])
def test_a_law_that_is_the_same_from_another_place_of_rest_is_told(sensor: str) -> None:
    """Where no channel shows the place of the mass: about either well k is twice that at the hilltop, of the other sign."""
    wells = oscillator("k*d + q*d**2 + k3*d**3 + c*v", k=-500.0, q=2e3, k3=8e6, c=1.0)
    across = lw.simulate(wells, release={"x:m1": 0.014}, duration=2.0, rate=RATE, sensors=(sensor,))
    fit = lw.identify(across.with_noise(40.0, seed=5), wells.unknown("all"))
    others = [finding for finding in fit.findings if "another place of rest" in finding]
    assert fit.trusted and len(others) == (2 if sensor == "a" else 0)
    values = [
        fit.coefficient("link.k").value,
        *(float(other.partition("k = ")[2].partition(",")[0]) for other in others),
    ]
    assert sum(value == pytest.approx(-500.0, rel=0.01) for value in values) == 1
