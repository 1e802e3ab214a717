"""What an unknown gain of a force ends with that the records do not tell, or that acts otherwise than its channel says."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from present import some
from structures import link, row_of_masses, structure

import linkwise as lw
from linkwise.likelihood.sensor_priors import errors_to_find
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.untold_gains import require_told

RATE = 200.0
FIRST, SECOND = (
    f"{40.0 * size}*({' + '.join(f'sin({w}*t + {w * w / 7.0})' for w in range(start, 100, 5))})"
    for size, start in ((1.0, 3), (0.6, 5))
)
PAIR = row_of_masses(
    [1.0, 1.0],
    lower=("k*d + k3*d**3 + c*v", {"k": 900.0, "k3": 2e5, "c": 0.6}),
    upper=("k*d + c*v", {"k": 1000.0, "c": 0.6}),
)
ASKED = PAIR.unknown("all")


def driven(subject: lw.Structure = PAIR, *, seed: int = 41, **shown: float) -> lw.Record:
    """Three seconds under a force on each mass; channels `force_m1` and so on show it times a factor."""
    forces = dict(zip(subject.mass_names, (FIRST, SECOND), strict=False))
    record = lw.simulate(subject, forces=forces, duration=3.0, rate=RATE).with_noise(35.0, seed=seed)
    values = record.values.copy()
    for name, text in forces.items():
        exact = lw.model.TimeFunction(text).value(record.time)
        values[:, record.channels.index(f"force:{name}")] = shown.get(f"force_{name}", 1.0) * exact
    return replace(record, values=values, simulated=None)


@pytest.mark.usefixtures("unrendered")
@pytest.mark.parametrize("seed", [41, 42])
def test_a_force_of_the_wrong_sign_is_named_beside_its_unknown_gain(seed: int, tmp_path: Path) -> None:
    """The search makes the force vanish, ever larger gains later, and has no standard errors there."""
    fit = lw.identify(driven(seed=seed, force_m1=-1.0), ASKED, gains=["force:m1"])
    assert not fit.trusted
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("sign", "force:m1")
    assert "change the sign of force:m1" in fit.message
    assert fit.sensor_errors == ()  # the gain is some 1e31
    lw.report.write_result(fit, tmp_path / "answer")
    assert not lw.validate(driven(seed=seed), tmp_path / "answer").coefficients  # the folder can be read


def test_an_interrupted_search_gives_the_best_so_far() -> None:
    """Of a gain for which the mass and the law stand as well, so that a search that ends is refused."""
    one = structure({"m1": 1.0}, link("s", "m1-ground", "k*d + c*v", k=900.0, c=0.6))
    reports: list[lw.estimates.ProgressReport] = []

    def stop(report: lw.estimates.ProgressReport) -> None:
        reports.append(report)
        if len(reports) == 2:
            raise KeyboardInterrupt

    record, asked = driven(one), one.unknown("all", "mass:m1")
    with pytest.raises(lw.IdentificationError, match="do not tell the gain of x:m1"):
        lw.identify(record, asked, gains=["x:m1"])
    fit = lw.identify(record, asked, gains=["x:m1"], progress=stop)
    assert not fit.trusted
    assert "nterrupted" in fit.message and "best so far" in fit.message


class Searched:
    """How a search ended that did not tell a gain."""

    untold = ("force:m1",)

    def __init__(self, status: AnnealingStatus, *, has_errors: bool, chi_square_off: bool) -> None:
        self.status, self.has_errors, self.chi_square_off = status, has_errors, chi_square_off


@pytest.mark.parametrize(
    ("status", "has_errors", "off", "refused"),
    [
        (AnnealingStatus.CONVERGED, True, False, True),
        (AnnealingStatus.CONVERGED, False, True, True),
        (AnnealingStatus.STUCK, True, False, True),
        (AnnealingStatus.STUCK, False, False, False),
        (AnnealingStatus.EXHAUSTED, True, True, False),
        (AnnealingStatus.INTERRUPTED, True, False, False),
    ],
)
def test_only_a_search_that_reached_the_records_says_what_they_tell(
    status: AnnealingStatus, has_errors: bool, off: bool, refused: bool
) -> None:
    fit = Searched(status, has_errors=has_errors, chi_square_off=off)
    if not refused:
        require_told(fit)
        return
    with pytest.raises(lw.IdentificationError, match=r"do not tell the gain of force:m1: .* Leave it out"):
        require_told(fit)


ALL_OF_PAIR = ["x:m1", "x:m2", "force:m1", "force:m2"]


def test_unknown_gains_of_every_channel_are_refused_unless_a_known_law_sets_the_scale() -> None:
    """Twice the forces make twice the motion where every cubic is a quarter of itself."""
    record = driven()
    with pytest.raises(
        lw.IdentificationError,
        match=r"do not tell the gain of x:m1, .*force:m2: every channel .* one of them out",
    ) as refusal:
        lw.identify(record, ASKED, gains=ALL_OF_PAIR)
    assert refusal.value.arguments == ("calibration",)
    fit = lw.identify(record, PAIR.unknown("lower.k", "lower.c", "upper"), gains=ALL_OF_PAIR)
    assert fit.trusted
    for error in some(fit.sensor_errors):
        assert abs(error.value - 1.0) < 5.0 * error.standard_error < 0.25
    for gains in (ALL_OF_PAIR[:3], ALL_OF_PAIR[1:]):
        assert lw.identify(record, ASKED, gains=gains).trusted


def test_the_gain_of_a_force_that_is_zero_throughout_is_refused() -> None:
    """It was said of its gain that another scale explains the records as well."""
    record = driven(force_m1=0.0)
    for keywords in ({"gains": ["force:m1"]}, {"delays": ["force:m1"]}):
        with pytest.raises(
            lw.IdentificationError, match=r"no gain or delay of force:m1 .* is 0 throughout the record"
        ):
            lw.identify(record, ASKED, **keywords)  # type: ignore[arg-type]  # of one of the keywords
    with pytest.raises(lw.IdentificationError, match="0 throughout the records"):
        lw.identify([record, driven(seed=42, force_m1=0.0)], ASKED, gains=["force:m1"])
    acting = errors_to_find([record, driven(seed=42)], gains=["force:m1"])  # in one of two
    assert acting["gains"] == ("force:m1",)
