"""Identification of links alone on a rig: states, intervals, offsets, verdicts and refusals."""

from typing import Any

import numpy as np
import pytest
import scipy
from present import present
from record_faults import changed
from rigs import BOUC_WEN, hysteretic, measured, rig, run
from structures import link, named, structure
from within import assert_within, errors, of

import linkwise as lw


@pytest.fixture(scope="module")
def record() -> lw.Record:
    return run(hysteretic())


@pytest.mark.slow
def test_a_hysteretic_link_is_found_without_starts_within_its_intervals() -> None:
    """By quantiles of one in 500 of intervals that hold, and on either side of the sum of squares, were they independent."""
    record, scores = run(hysteretic(), duration=3.0), []
    for seed in range(4):
        fit = lw.identify(measured(record, seed), hysteretic().unknown("damper"))
        assert fit.trusted, str(fit)
        scores.append(errors(fit, of("damper", BOUC_WEN)))
    count = np.size(scores)
    assert np.sum(np.abs(scores) < 1.96) >= scipy.stats.binom.ppf(0.002, count, 0.95)
    low, high = scipy.stats.chi2.ppf([0.002, 0.998], count)
    assert low < np.sum(np.square(scores)) < high


@pytest.mark.slow
def test_errors_of_the_motion_widen_the_intervals(record: lw.Record) -> None:
    fits = [
        lw.identify(measured(record, 1, displacement=noise), hysteretic().unknown("damper"))
        for noise in (1e-6, 1e-4)
    ]
    errors = [present(fit.coefficient("damper.x0").standard_error) for fit in fits]
    # 0.1 mm move the force by F/x0 0.1 mm where the link slips to and fro, 10 N beside 1 N of the cell: twice in the mean
    assert errors[1] > 2.0 * errors[0]


@pytest.mark.slow
def test_a_coarse_displacement_is_not_differenced(record: lw.Record) -> None:
    """Differences of steps of 0.1 mm at 200 Hz would be 20 mm/s beside a rate of 50 mm/s."""
    coarse = measured(record, 1, displacement=0.0, step=1e-4)
    fit = lw.identify(coarse, hysteretic().unknown("damper"))
    for name in ("k", "F", "x0"):
        # a mistake of differences is ten times larger
        assert fit.coefficient(f"damper.{name}").value == pytest.approx(BOUC_WEN[name], rel=0.05)


def test_a_law_without_states() -> None:
    law, values = "k*d + k3*d**3 + c*v", {"k": 2000.0, "k3": 4e7, "c": 50.0}
    fit = lw.identify(measured(run(rig(law, values)), 1), rig(law, values).unknown("damper"))
    assert fit.trusted and fit.masses == ()
    for name, value in values.items():
        interval = fit.coefficient(f"damper.{name}").interval
        assert interval is not None and interval[0] < value < interval[1]
    assert fit.links[0].frequencies == ()


@pytest.mark.slow
def test_starts_are_searched_for_in_the_part_of_a_long_record_that_moves_most() -> None:
    """A rest of 25 s, 5000 samples of 8000, comes before the motion; the search is in 4096, of which the last 2800 move."""
    base = "0.5*(1 + tanh(4*(t - 26)))*(0.01*sin(5*t)*sin(0.7*t) + 0.003*sin(17*t))"
    long = lw.simulate(hysteretic(), duration=40.0, rate=200.0, base=base)
    fit = lw.identify(measured(long, 1), hysteretic().unknown("damper"))
    assert fit.samples > 7_990
    assert_within(fit, of("damper", BOUC_WEN))


@pytest.mark.slow
def test_friction_of_bristles_is_found_without_starts() -> None:
    values = {"s0": 2e5, "s1": 100.0, "s2": 500.0, "Fc": 60.0, "Fs": 90.0, "vs": 5e-3}
    true = structure({}, named("damper", "base-ground", "lugre", **values))
    unknown = structure({}, named("damper", "base-ground", "lugre"))
    fit = lw.identify(measured(run(true), 1, displacement=1e-7), unknown)
    assert_within(fit, of("damper", values))


@pytest.mark.slow
def test_a_zero_error_of_the_load_cell_is_diagnosed_and_found(record: lw.Record) -> None:
    noisy = measured(record, 1)
    off = changed(noisy, f_damper=lambda x: x + 5.0)
    unknown = hysteretic().unknown("damper")
    fit = lw.identify(off, unknown, as_stated=True)
    assert fit.verdicts[0] is lw.Verdict.MEASUREMENT_ERROR
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("offset", "f:damper")
    assert fit.diagnosis[0].size == pytest.approx(5.0, rel=0.1)  # the first order
    again = lw.identify(off, unknown, admit=["offset"])
    assert again.trusted
    interval = again.coefficient("damper.F").interval
    assert interval is not None and interval[0] < BOUC_WEN["F"] < interval[1]
    assert any(remark.startswith("f:damper is off by") for remark in again.remarks)


def test_a_zero_error_of_the_displacement_of_a_cubic_spring() -> None:
    law, values = "k*d + k3*d**3 + c*v", {"k": 2000.0, "k3": 4e7, "c": 50.0}
    noisy = measured(run(rig(law, values)), 2)
    record = changed(noisy, x_base=lambda x: x + 1e-3)
    fit = lw.identify(record, rig(law, values).unknown("damper"), offsets=["x:base", "f:damper"])
    assert fit.trusted
    interval = fit.coefficient("damper.k3").interval
    assert interval is not None and interval[0] < values["k3"] < interval[1]
    assert any(remark.startswith("x:base is off by 0.001") for remark in fit.remarks)


@pytest.mark.slow
def test_records_are_fitted_together(record: lw.Record) -> None:
    parts = [measured(record, 3)[:1000], measured(record, 4)[1000:]]
    unknown = hysteretic().unknown("damper")
    both, single = lw.identify(parts, unknown), lw.identify(parts[0], unknown)
    # two parts of a length, less what settles in the second
    assert both.trusted and both.samples > 1.9 * single.samples
    errors = [present(fit.coefficient("damper.F").standard_error) for fit in (both, single)]
    assert errors[0] < errors[1]
    assert both.motion.d.shape == (len(record), 1)


def test_coefficients_that_the_force_does_not_tell_apart(record: lw.Record) -> None:
    law = "k*d + k2*d + c*v"
    values = {"k": 1.0, "k2": 1.0, "c": 1.0}
    noisy = measured(run(rig(law, {**values, "k": 2000.0, "c": 50.0})), 1)
    fit = lw.identify(noisy, rig(law, values).unknown("damper"))
    assert fit.verdicts[0] is lw.Verdict.HARDLY_DETERMINED
    assert fit.coefficient("damper.k").interval is None


@pytest.mark.slow
def test_the_motion_carries_measured_and_identified_forces(record: lw.Record) -> None:
    noisy = measured(record, 1)
    fit = lw.identify(noisy, hysteretic().unknown("damper"))
    motion = fit.motion
    assert motion.identified_force is not None and motion.force is not None
    np.testing.assert_array_equal(motion.force[:, 0], noisy.channel("f:damper"))
    left = motion.force - motion.identified_force
    assert np.sqrt(np.mean(left**2)) == pytest.approx(1.0, rel=0.1)  # the noise; the motion adds to it


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "no motion": ("x:base", {}, "identified from the displacement of its base, x:base"),
    "no force": ("f:damper", {}, "has no load cell of its link: give channel f:damper"),
    "gain": ("", {"gains": ["f:damper"]}, "not supported for links alone on a rig"),
    "drift": ("", {"drifts": ["x:base"]}, r"^drift \(x:base\): not supported"),
    "robust": ("", {"loss": lw.likelihood.Student()}, "a robust loss: not supported for links alone on a rig"),
    "offset": ("", {"offsets": ["x:m1"]}, "no offset of x:m1 can be found"),
    "sindy": ("", {"method": "sindy"}, 'links alone on a rig are not supported in method "sindy"'),
}  # fmt: skip


@pytest.mark.parametrize(("dropped", "options", "message"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused(record: lw.Record, dropped: str, options: dict[str, Any], message: str) -> None:
    names = [name for name in record.channels if name != dropped]
    with pytest.raises((lw.IdentificationError, lw.StructureError), match=message):
        lw.identify(record.select(names), hysteretic().unknown("damper"), **options)


ROOT, ROOTS = "k*sqrt(g + d)", {"k": 300.0, "g": 0.0135}  # the base moves by up to 0.013 m to either side


@pytest.mark.filterwarnings("error")
def test_values_with_which_a_law_is_not_finite_are_no_minimum() -> None:
    """Most trials of g are below the displacement, where the law has no value."""
    fit = lw.identify(measured(run(rig(ROOT, ROOTS)), 1), rig(ROOT, ROOTS).unknown("damper"))
    assert_within(fit, of("damper", ROOTS))


@pytest.mark.filterwarnings("error")
def test_starts_with_which_a_law_is_not_finite_are_refused() -> None:
    noisy = measured(run(rig(ROOT, ROOTS)), 1)
    with pytest.raises(lw.IdentificationError, match="no values were found with which the law of damper"):
        lw.identify(noisy, rig(ROOT, ROOTS).unknown("damper"), starts={"damper.g": 1e-4})


def test_records_with_different_load_cells_are_refused() -> None:
    pair = structure({}, *(link(name, "base-ground", "k*d", k=2000.0) for name in ("a", "b")))
    both = run(pair, 2.0)
    single = both.select(["x:base", "f:a"])[:300]
    for records in ([both, single], [single, both]):
        with pytest.raises(lw.IdentificationError, match="need the same channels in the same order"):
            lw.identify(records, pair.unknown("a"))


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("channel", "value", "message"),
    [("f:damper", np.nan, "f:damper has no sample"), ("x:base", 0.01, "x:base does not change")],
)
def test_useless_channels_are_refused(record: lw.Record, channel: str, value: float, message: str) -> None:
    with pytest.raises(lw.IdentificationError, match=message):
        lw.identify(changed(record, **{channel: value}), hysteretic().unknown("damper"))


def test_other_doors_refuse_a_rig() -> None:
    structure = rig("k*d", {"k": 1.0})
    for door in (
        lambda: lw.limit(structure.unknown("damper"), duration=1.0, rate=100.0, noise=40.0),
        lambda: lw.absorb(structure, sinks=["damper"], duration=1.0),
    ):
        with pytest.raises(lw.StructureError, match="links alone on a rig are not supported"):
            door()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("term", "value", "named"), [("q*d**3", 3e6, "d**3"), ("q*tanh(v/0.01)", 1.5, "tanh(v)")]
)
def test_a_missing_term_that_noise_hides_takes_trust(term: str, value: float, named: str) -> None:
    """Chi-square is within chance of 1; a coefficient was up to 54 standard errors off, and trusted."""
    values = {"k": 2000.0, "c": 50.0}
    true = rig(f"k*d + c*v + {term}", {**values, "q": value})
    fit = lw.identify(measured(run(true), 1, force=2.0), rig("k*d + c*v", values).unknown("damper"))
    assert fit.fit_verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert fit.diagnosis[0].kind == "term"
    assert any(cause.term == named for cause in fit.diagnosis)
    assert fit.coefficient("damper.k").standard_error is None


@pytest.mark.slow
def test_a_late_load_cell_takes_trust(record: lw.Record) -> None:
    """By a sample: the damping was six standard errors off, and negative."""
    noisy = measured(record, 1)
    late = np.column_stack([np.roll(noisy.channel("f:damper"), 1), noisy.channel("x:base")])[1:]
    delayed = lw.Record(0.0, record.rate, ("f:damper", "x:base"), late)
    fit = lw.identify(delayed, hysteretic().unknown("damper"))
    assert not fit.trusted
    assert any(cause.kind == "delay" and cause.where == "f:damper" for cause in fit.diagnosis)
