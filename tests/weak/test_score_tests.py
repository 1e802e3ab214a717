"""Answers of the weak form are judged by the likelihood: what follows the motion is named, and not trusted."""

from collections.abc import Callable

import numpy as np
import pytest
from problems import chain_record
from record_faults import changed
from structures import oscillator, row_of_masses

import linkwise as lw

pytestmark = pytest.mark.slow


Change = Callable[[np.ndarray, lw.Record], np.ndarray]


def faulty(change: Change, snr_db: float, clean: lw.Record | None = None, channel: str = "x:m2") -> lw.Record:
    """The record of the two-mass chain with a channel changed before noise is added."""
    clean = chain_record(2) if clean is None else clean
    return changed(clean, **{channel: change(clean.channel(channel), clean)}).with_noise(snr_db, seed=41)


@pytest.mark.parametrize(
    ("change", "snr_db", "kind"),
    [
        (lambda x, record: 1.01 * x, 40.0, "gain"),
        (  # which a cubic part of the sensor comes nearest to
            lambda x, record: np.clip(x, -0.7 * np.abs(x).max(), 0.7 * np.abs(x).max()),
            20.0,
            "nonlinearity",
        ),
    ],
    ids=["gain of 1 %", "clipping"],
)
def test_an_error_of_a_sensor_takes_trust_away(change: Change, snr_db: float, kind: str) -> None:
    """The power of what is left is within the limits, and the coefficients are wrong."""
    fit = lw.identify(faulty(change, snr_db), lw.bnes_chain(2).unknown("all"), method="weak")
    assert not fit.trusted and fit.coefficient("nes1.alpha").interval is None
    alike = [cause.where for cause in fit.diagnosis[:2] if cause.kind == kind]
    assert fit.diagnosis[0].kind == kind and {"x:m2", "all channels"} & set(alike)
    assert fit.diagnosis[0].description in fit.message


@pytest.mark.parametrize("masses", [2, 4])
@pytest.mark.parametrize("snr_db", [10.0, 40.0])
def test_clean_records_are_trusted(masses: int, snr_db: float) -> None:
    structure = lw.bnes_chain(masses).unknown("all")
    for seed in range(2):
        fit = lw.identify(chain_record(masses).with_noise(snr_db, seed=2000 + seed), structure, method="weak")
        assert fit.verdicts == (lw.Verdict.CONVERGED,), fit.message


BASES = {
    "three sines": "0.004*sin(40*t) + 0.003*sin(57*t + 1) + 0.002*sin(33*t + 2)",
    "a sine": "0.006*sin(40*t)",
}
SINK = "alpha*d + beta*d**3 + c*v"


@pytest.mark.parametrize("base", BASES)
def test_friction_under_a_steady_input_takes_trust_away(base: str) -> None:
    """The damper was 38 to 62 standard errors off, and trusted: under an input all pieces of a record are alike.

    The same record is trusted where the law has the friction, and that of a sink without it.
    """
    smooth = oscillator(SINK, mass=0.02, to="base", alpha=-40.0, beta=9e4, c=0.3)
    law = f"{SINK} + F*tanh(v/0.05)"
    rubbing = oscillator(law, mass=0.02, to="base", alpha=-40.0, beta=9e4, c=0.3, F=0.01)
    noisy, clean = (
        lw.simulate(sink, duration=6.0, rate=500.0, base=BASES[base]).with_noise(40.0, seed=1)
        for sink in (rubbing, smooth)
    )
    fit = lw.identify(noisy, smooth.unknown("all"), method="weak")
    assert not fit.trusted and fit.coefficient("link.c").interval is None
    assert "a force like sign(v) in link" in fit.message or "a force like v*abs(v) in link" in fit.message
    for record, asked in ((noisy, rubbing), (clean, smooth)):
        right = lw.identify(record, asked.unknown("all"), method="weak")
        assert right.trusted, right.message


def test_a_law_of_numbers_alone_is_tested_too() -> None:
    """A known law beside an unknown one: what it lacks shows in the equation of its mass."""
    spring = oscillator("k*d + c*v + k3*d**3", k=900.0, k3=2e6, c=1.5)
    record = lw.simulate(spring, release={"v:m1": 0.5}, duration=4.0, rate=500.0).with_noise(40.0, seed=3)
    unknown = oscillator("k*d + c*v + 1.9e6*d**3", k=900.0, c=1.5).unknown("all")
    fit = lw.identify(record, unknown, method="weak")
    assert not fit.trusted and any(cause.term == "d**3" for cause in fit.diagnosis[:2])
    right = oscillator("k*d + c*v + 2e6*d**3", k=900.0, c=1.5).unknown("all")
    assert lw.identify(record, right, method="weak").trusted


def stiff_pair(snr_db: float, seed: int) -> tuple[lw.Structure, lw.Record]:
    """Two masses on a link so stiff that its elongation is far below the noise of both sensors."""
    law = "k*d + c*v"
    structure = row_of_masses(
        [1.0, 0.5], soft=(law, {"k": 2000.0, "c": 0.5}), stiff=(law, {"k": 2e4, "c": 2.0})
    )
    record = lw.simulate(structure, release={"v:m1": 1.0, "v:m2": 1.0}, duration=4.0, rate=1000.0)
    return structure, record.with_noise(snr_db, seed=seed)


def test_a_coefficient_that_hardly_stands_above_the_noise_takes_trust_away() -> None:
    structure, noisy = stiff_pair(20.0, seed=1)
    fit = lw.identify(noisy, structure.unknown("all"), method="weak")
    assert fit.verdicts[0] is lw.Verdict.HARDLY_DETERMINED and not fit.trusted
    assert (
        "hardly more information on stiff.k" in fit.message and fit.to_dict()["status"] == "hardly determined"
    )
    subject = structure.unknown("soft")
    assert lw.identify(noisy, subject, method="weak").trusted
    assert lw.identify(stiff_pair(25.0, seed=1)[1], structure.unknown("all"), method="weak").trusted


def test_a_bias_of_the_weak_form_takes_trust_away() -> None:
    """Gaps of a link bend the motion within its windows: the likelihood puts the spring many standard errors away."""
    law = "k*d + c*v + h*(max(d - 0.0005, 0) + min(d + 0.0005, 0))"
    knocking = oscillator(law, k=1000.0, c=2.0, h=2e4)
    clean = lw.simulate(knocking, forces={"m1": "4*sin(40*t) + 3*sin(71*t)"}, duration=6.0, rate=500.0)
    fit = lw.identify(clean.with_noise(50.0, seed=1), knocking.unknown("all"), method="weak")
    errors = (fit.values - [1000.0, 2.0, 2e4]) / np.sqrt(fit.covariance.diagonal())
    assert fit.verdicts == (lw.Verdict.BIASED,) and np.abs(errors).max() > 4.0
    assert "standard errors from here" in fit.message and fit.coefficient("link.k").interval is None
