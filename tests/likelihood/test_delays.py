"""Sensors that are late by parts of a sample or by several."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
import pytest
from numpy.polynomial import Polynomial
from present import present, some
from problems import chain_record
from structures import oscillator

import linkwise as lw
from linkwise.likelihood.fit import likelihood_fit
from linkwise.likelihood.options import LikelihoodOptions
from linkwise.likelihood.sensor_priors import errors_to_find, uncounted
from linkwise.likelihood.sensor_unknowns import answer_with_sensors
from linkwise.likelihood.shooting.anneal import AnnealingStatus
from linkwise.likelihood.shooting.flow import Trajectories
from linkwise.likelihood.shooting.late_sensors import late_motion
from linkwise.likelihood.shooting.loss import Gaussian
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.residuals import evaluate

CHAIN = lw.bnes_chain(2)
ASKED = CHAIN.unknown("all")
FINE = 10  # samples of the exact motion in one of the record
SENSORS = ("x:m1", "x:m2", "v:m1", "a:m2")


def late(name: str, tenths: int, seed: int, snr_db: float = 30.0) -> lw.Record:
    """Four channels, one of them late by `tenths` of a sample, from exact motion at ten times the rate."""
    fine = chain_record(2, duration=1.6, rate=1000.0 * FINE, sensors=SENSORS)
    start, count = 100, 1400
    columns = []
    for channel in SENSORS:
        first = start * FINE - (tenths if channel == name else 0)
        columns.append(fine.channel(channel)[first : first + count * FINE : FINE])
    record = lw.Record(0.0, 1000.0, SENSORS, np.stack(columns, axis=1))
    return record.with_noise(snr_db, seed=seed)


def delay_found(fit: lw.Estimate, name: str) -> tuple[float, float]:
    """The delay in s that was found, and its standard error."""
    pattern = rf"{name} is late by (\S+) ms \(estimated with the other unknowns, standard error (\S+) ms\)\."
    [match] = [candidate for candidate in (re.match(pattern, line) for line in fit.findings) if candidate]
    return 1e-3 * float(match[1]), 1e-3 * float(match[2])


@pytest.mark.parametrize("name", SENSORS)
@pytest.mark.parametrize("tenths", [3, -7])
def test_a_delay_of_one_of_four_channels_is_found_with_the_laws(name: str, tenths: int) -> None:
    record = late(name, tenths, seed=31)
    fit = lw.identify(record, ASKED, delays=[name])
    delay, deviation = delay_found(fit, name)
    assert fit.trusted
    assert delay == pytest.approx(1e-4 * tenths, abs=2e-5)  # a fiftieth of a sample
    # five deviations, 6e-7 of chance; here, below and for the laws
    assert delay == pytest.approx(1e-4 * tenths, abs=5.0 * deviation)
    for parameter in some(ASKED.parameters):
        estimate = fit.coefficient(parameter.name)
        error = estimate.value - present(CHAIN.coefficient(parameter.name).value)
        assert abs(error) < 5.0 * present(estimate.standard_error)


def test_a_delay_of_several_samples_is_found_after_whole_shifts() -> None:
    record = late("a:m2", 34, seed=32)
    fit = lw.identify(record, ASKED, delays=["a:m2"])
    delay, deviation = delay_found(fit, "a:m2")
    assert fit.trusted and delay == pytest.approx(3.4e-3, abs=5.0 * deviation)


def test_a_delay_is_admitted_and_without_that_not_trusted() -> None:
    record = late("x:m2", 3, seed=33)
    alone = lw.identify(record, ASKED)
    assert not alone.trusted
    assert (alone.diagnosis[0].kind, alone.diagnosis[0].where) == ("delay", "x:m2")
    fit = lw.identify(record, ASKED, admit=["delay"])
    delay, deviation = delay_found(fit, "x:m2")
    assert fit.trusted and delay == pytest.approx(3e-4, abs=5.0 * deviation)


def test_a_delay_of_the_only_force_is_admitted_as_responses_that_are_early() -> None:
    """Two samples of 5 ms late, a multisine of 0.3 to 12 Hz; the diagnosis names the force."""
    structure = oscillator("k*d + b*d**3 + c*v", name="foot", k=400.0, b=3e4, c=1.2)
    lines = 2 * np.pi * np.arange(6, 240) / 20.0
    phases = np.random.default_rng(36).uniform(0.0, 2 * np.pi, len(lines))
    time = np.arange(4001) / 200.0
    applied, recorded = (
        0.55 * np.sin(lines * (time - delay)[:, None] + phases).sum(axis=1) for delay in (0.0, 0.01)
    )
    force = lw.model.Sampled(0.0, 200.0, applied)
    record = lw.simulate(structure, forces={"m1": force}, duration=20.0, rate=200.0).with_noise(35.0, seed=36)
    columns = np.stack([record.channel("x:m1"), recorded], axis=1)
    record = lw.Record(0.0, 200.0, ("x:m1", "force:m1"), columns)
    asked = structure.unknown("all")
    assert lw.identify(record, asked).diagnosis[0].kind == "force delay"
    fit = lw.identify(record, asked, admit=["delay"])
    delay, deviation = delay_found(fit, "x:m1")
    assert fit.trusted and delay == pytest.approx(-0.01, abs=5.0 * deviation)
    for name, true in (("foot.k", 400.0), ("foot.b", 3e4), ("foot.c", 1.2)):
        coefficient = fit.coefficient(name)
        assert abs(coefficient.value - true) < 4.0 * present(coefficient.standard_error)


def test_a_delay_of_no_sensor_is_refused() -> None:
    with pytest.raises(lw.IdentificationError, match="no delay of x:m9 can be estimated: the sensors"):
        lw.identify(late("x:m1", 0, seed=34), ASKED, delays=["x:m9"])


def test_errors_of_sensors_that_cannot_be_found_are_refused() -> None:
    record = late("a:m2", 30, seed=36)
    coarse = record.decimate(2)
    with pytest.raises(
        lw.IdentificationError,
        match=r"late by more than a sample, which cannot be found from records of different",
    ):
        lw.identify([record, coarse], ASKED, delays=["a:m2"])
    for errors in ({"delays": ["x:m1", "x:m1"]}, {"offsets": ["x:m1", "x:m1"]}):
        with pytest.raises(lw.IdentificationError, match="x:m1 is named twice"):
            lw.identify(record, ASKED, **errors)  # type: ignore[arg-type]  # of one of the keywords


def test_the_column_of_a_delay_is_its_difference_quotient() -> None:
    theta = np.array([present(CHAIN.coefficient(p.name).value) for p in ASKED.parameters])
    record = late("v:m1", 3, seed=35)[:300]
    options = LikelihoodOptions(delays=("v:m1", "x:m2"), gains=("v:m1",), model_error=False)
    fit = likelihood_fit([record], ASKED, theta, options=options)
    optimum = fit.optimum

    def data(delays: np.ndarray) -> float:
        point = replace(optimum.point, delays=delays)
        return evaluate(optimum.segments, point, optimum.scales, Gaussian()).data

    at = np.array([2e-4, -1e-4])
    misfit = evaluate(optimum.segments, replace(optimum.point, delays=at), optimum.scales, Gaussian())
    linear = linearise(optimum.segments, misfit, optimum.scales, Gaussian())
    gradient = -2.0 * linear.data.corner_gradient[-2:] / optimum.scales.theta[-2:]
    for number in range(2):
        shift = 1e-7 * np.eye(2)[number]
        quotient = (data(at + shift) - data(at - shift)) / 2e-7
        assert gradient[number] == pytest.approx(quotient, rel=1e-3)  # columns are kept in single precision


@pytest.mark.parametrize("kind", [0, 1, 2])
@pytest.mark.parametrize("delay", [0.5, -0.3])
@pytest.mark.parametrize("degree", [11, 12])
def test_the_motion_between_samples_is_of_degree_11(kind: int, delay: float, degree: int) -> None:
    """Motion t^11 is exact, and t^12 less the remainder of Hermite's polynomial: prod (t - t_i)^3 over four samples."""
    step, count, points = 0.4, 6, 4
    time = step * (np.arange(count) - 2.5)
    motion = Polynomial.basis(degree)
    states = np.stack([motion(time), step * motion.deriv()(time)], axis=1)[:, :, None, None]
    accelerations = motion.deriv(2)(time)[:, None, None]
    empty = np.empty((0, 0))
    orbit = Trajectories(states, empty, accelerations, empty, empty, empty, empty)
    shown, rate = late_motion(orbit, np.array([step]), 1, mass=0, kind=kind, delay=delay * step)
    # rounding of 1e-16 through coefficients of up to 1e3, and two digits; inside, the remainder is 1e-6 and more
    approximately = partial(pytest.approx, rel=1e-9, abs=1e-9 / step ** (kind + 1))
    for sample in range(count - 1):
        at = time[sample] - delay * step
        first = min(max(int(np.floor(sample - delay)) + 1 - points // 2, 0), count - points)
        around = np.repeat(time[first : first + points], 3)
        polynomial = motion if degree == 11 else motion - Polynomial.fromroots(around)
        assert shown[sample, 0] == approximately(polynomial.deriv(kind)(at))
        assert rate[sample, 0] == approximately(polynomial.deriv(kind + 1)(at))


QUAKE = "0.0004*sin(61*t) + 0.0003*sin(97*t + 1) + 0.0002*sin(131*t + 2) + 0.0001*sin(210*t)"
STOREY = oscillator("k*d + c*v", to="base", name="frame", k=19000.0, c=1.2)


def shaken(duration: float, late: float) -> lw.Record:
    """A storey on a shake table at 5.5 samples a period, whose sensor is `late` in s after that of the base."""
    record = lw.simulate(STOREY, base=QUAKE, duration=duration, rate=120.0, sensors=("a", "a:base"))
    record = record.with_noise(40.0, seed=1)
    early = lw.model.TimeFunction(QUAKE).derivative(record.time + late, 2)
    return replace(record, values=np.column_stack([record.channel("a:m1"), early]), simulated=None)


def explained(fit: lw.Estimate, late: float) -> None:
    """The fit is trusted, with a delay `late` in s and a stiffness within five deviations: 6e-7 of chance."""
    delay, deviation = delay_found(fit, "a:m1")
    stiffness = fit.coefficient("frame.k")
    assert fit.trusted
    assert abs(delay - late) < 5.0 * deviation
    assert abs(stiffness.value - 19000.0) < 5.0 * present(stiffness.standard_error)


def test_a_delay_of_a_third_of_a_period_is_found_beyond_nearer_optima() -> None:
    """A fit from no delay ends about half of the way."""
    explained(lw.identify(shaken(1.0, 0.015), STOREY.unknown("all"), delays=["a:m1"]), 0.015)


def test_half_a_sample_on_a_moving_base_is_found_as_a_delay_of_all_that_the_sensor_shows() -> None:
    """To first order the base alone would leave 9 % of a signal at 33 Hz, nine times the noise."""
    explained(lw.identify(shaken(1.5, 0.0042), STOREY.unknown("all"), delays=["a:m1"]), 0.0042)


def test_a_base_that_is_late_is_admitted_as_a_response_that_is_early() -> None:
    """The diagnosis names the base, whose delay no parameter stands for."""
    record, unknown = shaken(1.5, -0.002), STOREY.unknown("all")
    first = lw.identify(record, unknown).diagnosis[0]
    assert (first.kind, first.where) == ("delay", "a:base")
    explained(lw.identify(record, unknown, admit=["delay"]), -0.002)


@dataclass(frozen=True)
class Found:
    """A fit that explains nothing, of a delay below half a sample."""

    chi_square: float
    status: AnnealingStatus = AnnealingStatus.CONVERGED
    chi_square_off: bool = True
    model_error: float = 0.0
    delays: Mapping[str, float] = field(default_factory=lambda: {"a:m1": 1e-3})
    diagnosis: tuple[lw.estimates.Cause, ...] = ()


def shifts_tried(answers: Callable[[int], Found]) -> tuple[Found, list[int]]:
    """The fit that was kept and the shifts in samples that were looked at, from a search with these `answers`."""
    record = shaken(1.0, 0.0)
    tried: list[int] = []

    def search(records: Sequence[lw.Record], options: LikelihoodOptions) -> Found:
        tried.append(round(options.shifts["a:m1"] * 120.0))
        return answers(tried[-1])

    options = LikelihoodOptions(delays=["a:m1"])
    answer = answer_with_sensors(search, [record], options, (), lambda fit, records, delays: fit)
    return answer, tried


def test_shifts_without_a_fit_are_passed_over() -> None:
    def answers(shift: int) -> Found:
        if shift == 1:
            raise lw.IdentificationError("the motion runs to infinity")
        return Found(float(abs(shift + 3)))

    answer, tried = shifts_tried(answers)
    assert answer.chi_square == 0.0
    assert tried[:3] == [0, 1, -1]


@pytest.mark.parametrize("far", [1, -2])
def test_a_delay_at_the_end_of_its_range_is_no_optimum(far: int) -> None:
    """A sample and a half at this shift, of which the next one stands for a half, and explains less."""

    def answers(shift: int) -> Found:
        ended = Found(1.0, model_error=5.0, delays={"a:m1": -1.5 * float(np.sign(far)) / 120.0})
        return ended if shift == far else Found(4.0 + abs(shift), model_error=0.5)

    answer, tried = shifts_tried(answers)
    assert far in tried
    assert answer.delays == {"a:m1": 1e-3}
    assert answer.model_error == 0.5


def test_an_interrupt_ends_the_search_over_shifts() -> None:
    stopped = Found(9.0, status=AnnealingStatus.INTERRUPTED)
    answer, tried = shifts_tried(lambda shift: stopped if shift == 1 else Found(1.0))
    assert answer is stopped
    assert tried == [0, 1]


def test_the_delay_of_the_only_input_is_that_of_the_responses() -> None:
    stated = {
        "a:base": lw.records.SensorUncertainty(delay=np.inf),
        "a:m1": lw.records.SensorUncertainty(gain=0.01),
    }
    record = lw.simulate(STOREY, base=QUAKE, duration=1.0, rate=120.0, sensors=("a", "a:base"))
    record = replace(record.with_noise(40.0, seed=2), uncertainty=stated)
    options = errors_to_find([record])
    assert options["delays"] == ("a:m1",)
    assert options["calibration"] == {"a:m1": 0.01}
    assert not uncounted([record], "ml")
    forced = lw.Record(0.0, 120.0, (*record.channels, "force:m1"), np.pad(record.values, ((0, 0), (0, 1))))
    [remark] = uncounted([replace(forced, uncertainty=stated)], "ml")
    assert "errors of a:base is not counted" in remark
