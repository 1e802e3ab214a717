"""What is unknown of sensors and inputs: each kind is one class, and tested by the column that estimates it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
import pytest
from present import present
from problems import chain_record, truth
from record_faults import changed
from structures import link, row_of_masses, structure
from within import errors

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.estimates.causes import CAUSE_KINDS, FOUND, CauseKind, SensorErrorEstimate
from linkwise.likelihood.options import OF_FORCE, LikelihoodOptions
from linkwise.likelihood.problem import Problem, ShootingProblem, shooting_problem
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.residuals import Gaussian, evaluate
from linkwise.likelihood.shooting.tangents import whitened_jacobian
from linkwise.likelihood.terms import ERRORS, Crosstalk, Delay, Drift, Gain, Shown, Term, Waveform
from linkwise.likelihood.tests.columns import (
    FittedMotion,
    TestedColumns,
    base_errors,
    errors_of_sensors,
    inertia_and_inputs,
)

PAIR = row_of_masses(
    [1.0, 1.0],
    lower=("k*d + k3*d**3 + c*v", {"k": 900.0, "k3": 2e5, "c": 0.6}),
    upper=("k*d + c*v", {"k": 1000.0, "c": 0.6}),
)
ASKED = PAIR.unknown("all")
HUNG = structure(
    {"m1": 1.0, "m2": 0.5},
    link("a", "m1-base", "k*d + c*v", k=400.0, c=1.5),
    link("b", "m2-m1", "k*d + k3*d**3 + c*v", k=200.0, k3=2e5, c=0.8),
)
QUAKE = "0.01*sin(6*t*(1 + 0.3*t)) + 0.006*sin(23*t)"
DURATION = 1.995  # of 80 segments of five samples


@pytest.fixture(scope="module")
def record() -> lw.Record:
    forces = {"m1": "40*sin(31*t + 1) + 20*sin(53*t)", "m2": "30*sin(11*t)"}
    return lw.simulate(PAIR, forces=forces, duration=DURATION, rate=200.0).with_noise(80.0, seed=1)


def problem(
    record: lw.Record, errors: Sequence[Term], of: lw.Structure = PAIR
) -> tuple[Problem, ShootingProblem]:
    asked = of.unknown("all")
    sensing = Problem.of(LikelihoodOptions(errors), [record], asked)
    return sensing, shooting_problem(sensing, truth(of, asked), None)


def columns_of_estimate(record: lw.Record, term: Term, of: lw.Structure = PAIR) -> Floats:
    """(M, C, K, w) what each size of a term adds to the samples in its units, by differences of the estimated model."""
    sensing, posed = problem(record, present(term.beside((), record)), of)
    kinds = [one.term.kind for one in sensing.unknowns for _ in one.known]
    start, columns = posed.start, []
    for number, kind in enumerate(kinds, start=len(of.unknown("all").parameters)):
        if kind != term.kind:  # a delay beside a clock
            continue
        step = 1e-3 * posed.scales.theta * (np.arange(len(posed.scales.theta)) == number)
        ahead, behind = (
            evaluate(
                posed.segments, start.moved(start.nodes, start.border + change), posed.scales, Gaussian()
            )
            for change in (step, -step)
        )
        columns.append((behind.residuals - ahead.residuals) / (2.0 * step[number]))
    return np.stack(columns, axis=-1)


def column_of_test(record: lw.Record, kind: str, channel: str, of: lw.Structure = PAIR) -> Floats:
    """(M, C, K) what is tested along the motion of the model without the error."""
    _, posed = problem(record, (), of)
    misfit = evaluate(posed.segments, posed.start, posed.scales, Gaussian())
    optimum = Optimum(misfit, 1.0, 1.0)
    motion = FittedMotion(optimum, of, record.channels)
    named = {
        (one.error.kind, one.error.where): one
        for one in chain(inertia_and_inputs(motion), errors_of_sensors(motion), base_errors(motion))
    }
    columns = TestedColumns.of([named[kind, channel]])
    rows, _ = whitened_jacobian(misfit, slice(0, posed.segments.count), columns.forces, columns.errors)
    first = posed.segments.system.dimension + len(of.unknown("all").parameters)
    K = posed.segments.count
    added = rows[:, :, first : first + len(columns.owners)].sum(axis=2)
    values = added.reshape(K, len(posed.segments.samples), -1) / columns.units[0]
    return np.asarray(values.transpose(1, 2, 0))


CASES: dict[str, Term] = {
    **{kind: error("x:m2") for kind, error in ERRORS.items()},
    "drift": Drift("x:m2", DURATION),  # in one piece
    "crosstalk": Crosstalk("x:m2", source="x:m1"),
    "force gain": Gain("force:m1"),
    "force delay": Delay("force:m1"),
}


@pytest.mark.parametrize("kind", CASES)
def test_each_kind_is_tested_by_the_column_that_estimates_it(kind: str, record: lw.Record) -> None:
    """But for single precision, and the filter without which a clock would follow the noise of the samples.

    The other sizes of a high pass hold its start and its mean. Of a force it is tested what acts over what the channel shows.
    """
    columns, column = (
        columns_of_estimate(record, CASES[kind]),
        column_of_test(record, kind, CASES[kind].channel),
    )
    first, others = columns[..., 0].ravel(), columns[..., 1:].reshape(column.size, -1)
    difference = (-column if kind.startswith(OF_FORCE) else column).ravel() - first
    difference -= others @ np.linalg.lstsq(others, difference, rcond=None)[0]
    assert np.linalg.norm(difference) < (2e-2 if kind == "clock" else 5e-3) * np.linalg.norm(first)


@pytest.mark.parametrize("term", [Gain("a:base"), Delay("a:base")], ids=["gain", "delay"])
def test_errors_of_an_accelerating_base_are_tested_by_the_columns_that_estimate_them(term: Term) -> None:
    """They move all masses, and what sensors show that are not relative to the base; their rates are differences."""
    record = lw.simulate(
        HUNG,
        base=QUAKE,
        forces={"m1": "3*sin(31*t)"},
        duration=DURATION,
        rate=200.0,
        sensors=["a:m1", "rel:x:m2", "a:base"],
    ).with_noise(80.0, seed=1)
    of_estimate = columns_of_estimate(record, term, HUNG)[..., 0]
    difference = column_of_test(record, term.kind, term.channel, HUNG) - of_estimate
    inside = slice(1, -1)  # segments: no sensor of a late base is read at the ends of a record
    assert np.linalg.norm(difference[..., inside]) < 1e-2 * np.linalg.norm(of_estimate[..., inside])


@pytest.mark.slow
def test_a_base_that_moves_by_more_and_later_than_its_record_shows() -> None:
    """Beside a load cell, which has no delay: it acted nearly twice as recorded, and 4 ms before."""
    sensors = ["a:m1", "rel:v:m2", "f:b", "a:base"]
    record = lw.simulate(HUNG, base=QUAKE, duration=2.0, rate=250.0, sensors=sensors).with_noise(50.0, seed=4)
    late = lw.records.without_delays(record, {"a:base": -0.0042})
    recorded = changed(late, a_base=lambda a: 0.55 * a)
    fit = lw.identify(recorded, HUNG.unknown("all"), gains=["a:base"], delays=["a:base"])
    found = {(error.kind, error.channel): error for error in fit.sensor_errors}
    for kind, true in (("gain", 0.55), ("delay", 0.0042)):
        error = found[kind, "a:base"]
        assert abs(error.value - true) < 4.0 * error.standard_error
    assert fit.trusted and np.abs(errors(fit, HUNG)).max() < 4.0
    again = lw.validate(recorded, fit)
    assert "gain of a:base" in " ".join(again.remarks)
    beside = present(lw.identify(recorded, HUNG.unknown("all")).alternative)  # sensors may be wrong instead
    assert [(cause.kind, cause.where) for cause in beside.added] == [("gain", "a:base"), ("delay", "a:base")]
    assert beside.trusted and np.abs(errors(beside, HUNG)).max() < 4.0


@dataclass(frozen=True)
class Bend(Waveform):
    """A sensor that shows a part of the square of its motion as well."""

    kind, argument = "bend", "admit"

    def columns(self, shown: Shown) -> list[Floats]:
        return [shown.value**2]


def test_a_kind_of_error_is_a_class_and_its_words(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ERRORS, Bend.kind, Bend)
    monkeypatch.setitem(CAUSE_KINDS, Bend.kind, CauseKind("a bend of {0.where} by {0.size:.3g} 1/m", "1/m"))
    monkeypatch.setitem(FOUND, Bend.kind, "shows {0.value:.3g} 1/m of the square of its motion as well")
    clean, chain = chain_record(2, duration=2.0).with_noise(40.0, seed=5), lw.bnes_chain(2)
    sink = clean.channel("x:m2")
    bent = replace(
        clean, values=np.column_stack([clean.channel("x:m1"), sink + 1.5 * sink**2]), simulated=None
    )
    lacking = lw.identify(bent, chain.unknown("all"), as_stated=True)
    assert (lacking.diagnosis[0].kind, lacking.diagnosis[0].where) == ("bend", "x:m2")
    fit = lw.identify(bent, chain.unknown("all"), admit=["bend"])
    [error] = fit.sensor_errors
    assert error.value == pytest.approx(1.5, rel=0.05)  # along samples with their noise
    assert (
        error.description.startswith(f"x:m2 shows {error.value:.3g} 1/m of the square")
        and error.unit == "1/m"
    )


def test_crosstalk_is_estimated_where_it_is_let_and_where_it_alone_leaves_noise() -> None:
    clean, chain = chain_record(2, duration=2.0).with_noise(40.0, seed=6), lw.bnes_chain(2)
    mixed = clean.channel("x:m2") + 0.03 * clean.channel("x:m1")
    record = replace(clean, values=np.column_stack([clean.channel("x:m1"), mixed]), simulated=None)
    let = lw.identify(record, chain.unknown("all"), admit=["crosstalk"])
    by_itself = lw.identify(record, chain.unknown("all"))
    for fit in (let, by_itself):
        [error] = fit.sensor_errors
        assert (error.kind, error.channel, error.source) == ("crosstalk", "x:m2", "x:m1")
        assert abs(error.value - 0.03) < 4.0 * error.standard_error
        assert fit.trusted and np.abs(errors(fit, chain)).max() < 4.0
        assert SensorErrorEstimate.from_dict(error.to_dict()) == error
    assert f"x:m2 shows {error.value:.4g} of what x:m1 shows as well" in " ".join(str(by_itself).split())
    again = lw.validate(record, let)
    assert "crosstalk of x:m2" in " ".join(again.remarks)


@pytest.mark.parametrize(("kind", "size"), [("gain drift", 0.03), ("nonlinearity", 0.01)])
def test_an_error_that_laws_may_stand_for_is_a_second_answer(kind: str, size: float) -> None:
    forces = {"m1": "40*sin(31*t + 1) + 20*sin(53*t)"}
    clean = lw.simulate(PAIR, forces=forces, duration=4.0, rate=200.0)
    values, column = clean.values.copy(), clean.channels.index("x:m2")
    shown = values[:, column]
    form = clean.time / clean.duration if kind == "gain drift" else (shown / np.abs(shown).max()) ** 2
    values[:, column] = shown * (1.0 + size * form)
    fit = lw.identify(
        replace(clean, values=values, simulated=None).with_noise(50.0, seed=2), PAIR.unknown("all")
    )
    assert not fit.trusted and (fit.diagnosis[0].kind, fit.diagnosis[0].where) == (kind, "x:m2")
    beside = present(fit.alternative)
    [error] = beside.sensor_errors
    assert (error.kind, error.channel) == (kind, "x:m2")
    assert abs(error.value - size) < 4.0 * error.standard_error
    assert beside.trusted and np.abs(errors(beside, PAIR)).max() < 4.0


def test_a_channel_that_is_not_there_is_no_matter_of_the_record(record: lw.Record) -> None:
    """Every refusal was read as a fault of the record, and a wrong sign of a sensor named beside it."""
    with pytest.raises(lw.IdentificationError) as refused:
        lw.identify(record, ASKED, offsets=["x:m9"])
    assert (
        str(refused.value)
        == 'no offset of x:m9 can be estimated; did you mean "x:m2"?: the record has x:m1, x:m2'
    )
    assert refused.value.arguments == ("offsets",)


def test_a_high_pass_of_a_sensor_beside_a_recorded_acceleration_of_the_base() -> None:
    """A constant and a ramp belong to the drift of the integrals there, and made the equations singular."""
    sensors = ["x:m1", "x:m2", "a:base"]
    record = lw.simulate(HUNG, duration=3.0, rate=250.0, base=QUAKE, sensors=sensors).with_noise(45.0, seed=3)
    fit = lw.identify(record, HUNG.unknown("all"), corners=["x:m1"])
    assert fit.trusted and np.isfinite(fit.covariance).all()
