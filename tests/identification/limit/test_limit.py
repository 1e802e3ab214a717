"""The bound of a planned test: equal to a dense Fisher matrix, scaling as information does, silent about nothing."""

import json
import shlex
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import document, refusal, said
from present import present, some
from random_signals import random_force
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from structures import link, oscillator, structure

import linkwise as lw
from linkwise.identification.best_test import BestTest
from linkwise.output import to_json

RELEASE = {"v:m1": 1.0}
SHORT: dict[str, Any] = {"duration": 0.1, "rate": 500.0, "segment": 0.05, "release": RELEASE}
"""Two segments of 25 samples."""


def two_springs() -> lw.Structure:
    """One mass on two springs to the ground: a displacement sensor sees only their sum."""
    springs = link("one", "m1-ground", "k*d", k=100.0), link("two", "m1-ground", "k*d", k=50.0)
    return structure({"m1": 1.0}, *springs, link("damper", "m1-ground", "c*v", c=0.1))


def on_zener() -> lw.Structure:
    """One mass on a spring beside a spring and a damper in series, whose force is a state."""
    states = {"q": lw.model.LinkState("s*(v - q/c)", unit="N")}
    return structure({"m1": 1.0}, link("mount", "m1-ground", "k*d + q", states, k=900.0, s=600.0, c=30.0))


def motions(structures: list[lw.Structure], starts: np.ndarray, times: np.ndarray) -> np.ndarray:
    """(R, N, 2n + S) states from `starts` (R, 2n + S) at times[0], by an integrator that the bound does not use."""
    n, incidence = structures[0].size, structures[0].incidence.toarray()
    masses = np.stack([structure.mass_values for structure in structures])
    laws = [
        (alike[0].law, {name: np.array([link.values[name] for link in alike]) for name in alike[0].values})
        for alike in zip(*(structure.links for structure in structures), strict=True)
    ]

    def rates(_: float, flat: np.ndarray) -> np.ndarray:
        states = flat.reshape(len(structures), -1)
        d, v, memory = states[:, :n] @ incidence, states[:, n : 2 * n] @ incidence, iter(states[:, 2 * n :].T)
        forces: list[np.ndarray] = []
        inside: list[np.ndarray] = []
        for i, (law, given) in enumerate(laws):
            values = given | {name: next(memory) for name in law.states}
            forces.append(law.force(d[:, i], v[:, i], values))
            inside += law.state_rates(d[:, i], v[:, i], values) if law.states else []
        moved = -np.stack(forces, axis=1) @ incidence.T / masses
        return np.hstack([states[:, n : 2 * n], moved, *(rate[:, None] for rate in inside)]).ravel()

    solution = solve_ivp(
        rates, (times[0], times[-1]), starts.ravel(), method="DOP853", t_eval=times, rtol=1e-11, atol=1e-13
    )
    states: np.ndarray = solution.y.reshape(*starts.shape, -1).transpose(0, 2, 1)
    return states


def differences(structure: lw.Structure, limit: lw.analysis.Limit) -> list[np.ndarray]:
    """(p + m, N, m) for tangent segment: central differences of its m states with respect to theta and its start."""
    truth = present(limit.record.simulated)
    samples = round(limit.segment * limit.record.rate)
    memory = [values[:, None] for values in truth.states.values()]
    states = np.hstack([truth.displacement, truth.velocity, *memory])
    sizes = 1e-5 * np.abs(states).max(axis=0)
    tangents = []
    for first in range(0, len(states), samples):
        times = limit.record.time[first : first + samples]
        if len(times) < 2:
            continue
        structures, starts, steps = [], [], []
        for parameter, value in zip(limit.parameters, limit.values, strict=True):
            for side in (1.0, -1.0):
                structures.append(structure.with_values({parameter.name: value * (1.0 + side * 1e-4)}))
                starts.append(states[first])
            steps.append(1e-4 * value)
        for step in np.diag(sizes):
            structures += [structure] * 2
            starts += [states[first] + side * step for side in (1.0, -1.0)]
            steps.append(step.max())
        moved = motions(structures, np.array(starts), times)
        tangents.append((moved[::2] - moved[1::2]) / (2.0 * np.array(steps)[:, None, None]))
    assert all(tangent.shape[2] == states.shape[1] for tangent in some(tangents))
    return tangents


def dense_covariance(tangents: list[np.ndarray], limit: lw.analysis.Limit, sensor: int) -> np.ndarray:
    """(p, p) from the whole Fisher matrix of theta and all starts."""
    p, size = len(limit.parameters), tangents[0].shape[2]
    n = limit.structure.size
    columns = slice(sensor * n, (sensor + 1) * n)
    sigma = np.array(list(limit.noise.values()))
    fisher = np.zeros((p + size * len(tangents),) * 2)
    for number, tangent in enumerate(tangents):
        jacobian = np.array([row.ravel() for row in tangent[:, :, columns] / sigma]).T
        where = [*range(p), *range(p + size * number, p + size * (number + 1))]
        fisher[np.ix_(where, where)] += jacobian.T @ jacobian
    determined = np.flatnonzero(fisher.diagonal() > 0.0)
    scale = np.sqrt(fisher.diagonal()[determined])
    inverse = np.linalg.inv(fisher[np.ix_(determined, determined)] / np.outer(scale, scale))
    covariance: np.ndarray = inverse[:p, :p] / np.outer(scale[:p], scale[:p])
    return covariance


def scaled_difference(limit: lw.analysis.Limit, covariance: np.ndarray, scale: np.ndarray) -> float:
    """The largest entry of a difference of covariances, in standard errors `scale`."""
    return float(np.abs((limit.covariance - covariance) / np.outer(scale, scale)).max())


@pytest.fixture(scope="module")
def tangents(chain: lw.Structure) -> list[np.ndarray]:
    """Of the motion that is the same whatever sees it."""
    return differences(chain, lw.limit(chain, sensors=("x",), noise=20.0, **SHORT))


@pytest.mark.parametrize("kind", ["x", "v"])
def test_equals_the_dense_fisher_matrix(chain: lw.Structure, tangents: list[np.ndarray], kind: str) -> None:
    limit = lw.limit(chain, sensors=(kind,), noise=20.0, **SHORT)
    dense = dense_covariance(tangents, limit, "xv".index(kind))
    scale = limit.standard_errors
    # tangents of order 4 that turn 1/4 at most a step, over 25 samples
    assert scaled_difference(limit, dense, scale) < 2e-3
    if kind == "x":  # and what must be refused: a tenth more noise
        noisier = lw.limit(chain, sensors=("x",), noise=19.0, **SHORT)
        # 10^0.1 - 1 = 0.26 in variance; measured 0.259
        assert scaled_difference(noisier, dense, scale) > 0.1


def test_of_a_link_with_memory_equals_the_dense_fisher_matrix() -> None:
    """With its state unknown at the start of each segment; the force counts how the state follows the coefficients."""
    structure = on_zener()
    limit = lw.limit(
        structure, sensors=("x",), noise=20.0, duration=0.4, rate=200.0, segment=0.2, release=RELEASE
    )
    dense = dense_covariance(differences(structure, limit), limit, 0)
    # tangents of order 4 that turn 1/4 at most a step, over 40 samples
    assert scaled_difference(limit, dense, limit.standard_errors) < 2e-3
    mount, truth = limit.link("mount"), present(limit.record.simulated)

    def force(values: dict[str, float]) -> np.ndarray:
        """(N,) along the motion of the test, from a state of 0."""
        d, rate = CubicSpline(limit.record.time, truth.displacement[:, 0]), truth.velocity[:, 0]
        v = CubicSpline(limit.record.time, rate)
        inside = solve_ivp(
            lambda t, q: values["s"] * (v(t) - q / values["c"]), (0.0, limit.record.time[-1]), [0.0],
            method="DOP853", t_eval=limit.record.time, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        return np.asarray(values["k"] * d(limit.record.time) + inside.y[0])

    values = structure.link("mount").values
    slopes = []
    for key in (parameter.name.partition(".")[2] for parameter in limit.parameters):
        step = 1e-4 * values[key]
        above, below = (force({**values, key: values[key] + side}) for side in (step, -step))
        slopes.append((above - below) / (2.0 * step))
    variance = np.einsum("pn,pq,qn->n", slopes, limit.covariance, slopes)
    # the trapezoidal rule is off by (h w)^2/12 in a state that moves with w = sqrt((k + s)/m) = 39 rad/s: 0.3 %; twice that
    assert mount.force_error == pytest.approx(float(np.sqrt(variance.mean())), rel=2 * (0.005 * 39) ** 2 / 12)


def test_of_one_segment_is_what_identify_reaches_with_memory() -> None:
    plan: dict[str, Any] = {"duration": 2.0, "rate": 200.0, "release": {"v:m1": 1.0}}
    limit = lw.limit(on_zener(), noise=40.0, segment=2.0, **plan)
    record = lw.simulate(on_zener(), **plan).with_noise(40.0, seed=23)
    fit = lw.identify(record, on_zener().unknown("all"))
    reached = [present(fit.coefficient(parameter.name).standard_error) for parameter in limit.parameters]
    # the noise is found from 401 samples, to 1/sqrt(802) = 3.5 %, and the bound is taken at the truth
    np.testing.assert_allclose(reached, limit.standard_errors, rtol=3 * 0.035)


def test_scales_with_the_noise_and_with_the_samples(chain: lw.Structure) -> None:
    plan: dict[str, Any] = {"duration": 1.0, "release": RELEASE, "segment": 0.25}
    bound = lw.limit(chain, rate=1000.0, noise={"x:m1": 1e-4, "x:m2": 1e-3}, **plan)
    noisier = lw.limit(chain, rate=1000.0, noise={"x:m1": 2e-4, "x:m2": 2e-3}, **plan)
    np.testing.assert_allclose(noisier.covariance, 4.0 * bound.covariance, rtol=1e-8)  # same numerics
    denser = lw.limit(chain, rate=4000.0, noise=dict(bound.noise), **plan)
    # four times the samples of the same motion; the ends of 250 samples shift by less than one of them
    np.testing.assert_allclose(4.0 * np.diag(denser.covariance), np.diag(bound.covariance), rtol=4.0 / 250.0)


def test_the_papers_chain_has_the_bound_of_methods(chain: lw.Structure) -> None:
    """METHODS section 5: 8.8e-4 % for the worst link; where segments begin and end moves it by a quarter."""
    limit = lw.limit(chain, duration=6.0, rate=1000.0, noise=20.0, release=RELEASE, segment=0.25)
    assert max(link.nmse for link in limit.links) == pytest.approx(8.8e-4, rel=0.25)
    sink = limit.link("nes1")
    assert [well.value for well in sink.estimate.wells] == pytest.approx([-0.01, 0.01], rel=1e-9)
    assert sink.estimate.barrier is not None and sink.estimate.barrier.interval is not None
    error = limit.coefficient("nes1.alpha").standard_error
    assert error == pytest.approx(float(np.sqrt(limit.covariance[2, 2])), rel=1e-12)


@pytest.mark.slow
def test_force_deviation_is_that_of_the_coefficients(chain: lw.Structure) -> None:
    limit = lw.limit(chain, duration=1.0, rate=1000.0, noise=20.0, release=RELEASE, unknown=("nes",))
    assert [p.name for p in limit.parameters] == ["nes1.alpha", "nes1.beta", "nes1.c"]
    d = np.array([0.0, 0.01, 0.03])
    gradient = np.stack([d, d**3], axis=1)
    expected = np.sqrt(np.einsum("ni,ij,nj->n", gradient, limit.covariance[:2, :2], gradient))
    np.testing.assert_allclose(limit.force_deviation("nes1", d), expected, rtol=1e-12)
    np.testing.assert_array_equal(limit.force_deviation("spring1", d), 0.0)  # it is known


@pytest.mark.slow
def test_forces_and_the_base_drive_it() -> None:
    mounted = oscillator("k*d + c*v", to="base", name="mount", k=400.0, c=2.0)
    plan: dict[str, Any] = {"duration": 2.0, "rate": 200.0, "noise": {"x:m1": 1e-4}}
    small = lw.limit(mounted, base="0.001*sin(15*t)", **plan)
    large = lw.limit(mounted, base="0.002*sin(15*t)", **plan)
    # twice the motion of a linear structure, twice the slopes: same numerics but single precision
    np.testing.assert_allclose(large.standard_errors, 0.5 * small.standard_errors, rtol=1e-4)
    pushed = lw.limit(mounted, base="0", forces={"m1": "sin(15*t)"}, unknown=("mount", "mass:m1"), **plan)
    assert np.isfinite(pushed.standard_errors).all()
    free = lw.limit(mounted, base="0", release={"x:m1": 0.01}, unknown=("mount", "mass:m1"), **plan)
    assert "confounded" in free.findings[0] and "m1.mass" in free.findings[0]
    assert np.isinf(present(free.coefficient("m1.mass").standard_error))


@pytest.mark.slow
def test_what_sensors_cannot_tell_is_said() -> None:
    limit = lw.limit(two_springs(), duration=2.0, rate=200.0, noise=30.0, release={"x:m1": 0.01})
    assert np.isinf(limit.standard_errors).tolist() == [True, True, False]
    assert limit.coefficient("one.k").interval is None
    assert np.isinf(limit.link("one").nmse) and limit.link("one").estimate.covariance is None
    assert limit.findings == (
        "one.k and two.k are confounded: these sensors identify a combination of them only. Give one of them as known, or "
        "add a sensor or a force that moves them differently.",
    )
    table = str(limit)
    assert "not identifiable" in table and f"! {limit.findings[0]}" in table
    document = json.loads(to_json(limit.to_dict()))
    assert document["coefficients"]["one.k"]["standard_error"] is None
    assert document["links"]["damper"]["force_error"] == 0.0  # it has no force at rest
    noise = {"x:m1": 1e-4, "x:m2": 1e-4}
    still = lw.limit(lw.bnes_chain(2), duration=0.5, rate=1000.0, noise=noise, release={"v:m1": 0.0})
    assert np.isinf(still.standard_errors).all()
    assert "spring1.c has no effect on these sensors: this test cannot identify it." in still.findings


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"noise": {"x:m1": 1e-4}}, "x:m2 is missing"),
        ({"noise": {"x:m1": 1e-4, "x:m2": 1e-4, "x:m3": 1.0}}, "x:m3 is not a sensor of this test"),
        ({"noise": {"x:m1": 1e-4, "x:m2": 0.0}}, "the noise of x:m2 is 0.0; it must be a positive number"),
        ({"noise": float("nan")}, "must be within 1000 dB of zero, got nan dB"),
        ({"release": {"v:m1": 0.0}}, "x:m1 does not move in this test"),
        ({"segment": 0.002}, "no more than the 4 states at its start"),
    ],
)
def test_refuses_what_cannot_be_planned(chain: lw.Structure, changes: dict[str, Any], message: str) -> None:
    plan: dict[str, Any] = {"duration": 0.5, "rate": 1000.0, "noise": 20.0, "release": RELEASE}
    with pytest.raises(lw.IdentificationError, match=message):
        lw.limit(chain, **{**plan, **changes})


def test_needs_numbers_to_plan_around_and_names_that_are_there(chain: lw.Structure) -> None:
    message = r"nes1\.alpha, nes1\.beta, nes1\.c lack: write a number"
    with pytest.raises(lw.IdentificationError, match=message):
        lw.limit(chain.unknown("nes"), duration=0.5, rate=1000.0, noise=20.0, release=RELEASE)
    limit = lw.limit(chain, noise=20.0, unknown=("nes1.alpha",), **SHORT)
    message = r'"nes1\.gamma" is not an unknown of this test; choose from nes1\.alpha'
    with pytest.raises(lw.IdentificationError, match=message):
        limit.coefficient("nes1.gamma")
    message = 'nothing is unknown in a link "spring1" of this test; choose from nes1'
    with pytest.raises(lw.IdentificationError, match=message):
        limit.link("spring1")


def valve() -> tuple[lw.Structure, dict[str, Any]]:
    """A damper whose valve is moved while a force shakes it, and its test."""
    subject = lw.rig(
        {"body": 12.0},
        {"strut": "body - ground: k*d + (c0 + cu*u)*v"},
        {"strut.k": 9000.0, "strut.c0": 25.0, "strut.cu": 18.0},
        signals={"u": "V"},
    )
    return subject, {
        "duration": 4.0,
        "rate": 200.0,
        "forces": {"body": "60*sin(12*t) + 60*sin(31*t)"},
        "signals": {"u": "1.5 + sin(2.3*t)"},
    }


def test_a_law_with_a_signal_is_planned_as_it_is_identified() -> None:
    subject, test = valve()
    planned = lw.limit(subject, noise=40.0, **test)
    fit = lw.identify(lw.simulate(subject, **test).with_noise(40.0, seed=3), subject.unknown("all"))
    stated = np.sqrt(fit.covariance.diagonal())
    assert fit.trusted and planned.standard_errors == pytest.approx(stated, rel=0.1)
    assert planned.link("strut").force_error > 0.0
    with pytest.raises(lw.StructureError, match="which is not supported in forces at rest"):
        planned.force_deviation("strut", 0.0)


@pytest.mark.slow
def test_noise_of_a_force_is_in_the_limit_as_in_the_scatter_of_tests() -> None:
    """The scatter of 30 estimates is known to within an eighth; linked segments are a little better than free ones."""
    subject = oscillator("k*d + c*v", name="spring", k=3000.0, c=4.0)
    rng = np.random.default_rng(8)
    force = random_force(rng, 6.0, 200.0)
    test: dict[str, Any] = {"duration": 6.0, "rate": 200.0, "forces": {"m1": force}}
    clean = lw.simulate(subject, **test)
    noise = {"x:m1": 0.01 * float(clean.channel("x:m1").std()), "force:m1": 0.2}
    planned = lw.limit(subject, noise=noise, **test).standard_errors
    alone = lw.limit(subject, noise={"x:m1": noise["x:m1"]}, **test).standard_errors
    deviations = [noise[str(name)] for name in clean.channels]
    values = []
    for _ in range(30):
        shown = clean.values + deviations * rng.standard_normal(clean.values.shape)
        record = replace(clean, values=shown, simulated=None)
        values.append(lw.identify(record, subject.unknown("all"), as_stated=True).values)
    scatter = np.std(values, axis=0, ddof=1)
    assert np.all(scatter > 0.6 * planned) and np.all(scatter < 1.4 * planned)
    assert np.all(planned > 2.0 * alone)


def test_noise_of_a_hammer_acts_while_it_hits_in_limits_and_intervals() -> None:
    """It moves the motion behind a hit, and not the decay of that: damping is known nearly as well as without it."""
    subject = oscillator("k*d + c*v", name="spring", k=3000.0, c=4.0)
    time = np.arange(2001) / 1000.0
    hit = np.where((time > 0.1) & (time < 0.12), 200.0 * np.sin(50.0 * np.pi * (time - 0.1)) ** 2, 0.0)
    test: dict[str, Any] = {"duration": 2.0, "rate": 1000.0}
    test["forces"] = {"m1": lw.model.Sampled(0.0, 1000.0, hit)}
    clean = lw.simulate(subject, **test)
    noise = {"x:m1": 0.1 * float(clean.channel("x:m1").std()), "force:m1": 2.0}
    planned = lw.limit(subject, noise=noise, **test).standard_errors
    alone = lw.limit(subject, noise={"x:m1": noise["x:m1"]}, **test).standard_errors
    assert np.all(planned > alone) and np.all(planned < 1.2 * alone)
    deviations = [noise[str(name)] for name in clean.channels]
    shown = clean.values + deviations * np.random.default_rng(31).standard_normal(clean.values.shape)
    fit = lw.identify(replace(clean, values=shown, simulated=None), subject.unknown("all"))
    assert fit.trusted
    assert np.sqrt(fit.covariance.diagonal()) == pytest.approx(planned, rel=0.3)


def test_noise_of_a_signal_in_a_rate_is_refused() -> None:
    law = lw.Law.parse("k*d - Bl*i", {"i": "(u - R*i)/L"}, signals={"u": "V"})
    motor = lw.Link("motor", ("cone", "ground"), law, {"k": 2300.0, "Bl": 5.3, "R": 6.4, "L": 4e-4})
    subject = lw.Structure("speaker", (lw.Mass("cone", "12 g"),), (motor,))
    noise = {"x:cone": 1e-5, "signal:u": 0.1}
    with pytest.raises(lw.IdentificationError, match="noise of signal:u is not allowed for"):
        lw.limit(subject, duration=0.1, rate=4000.0, noise=noise, signals={"u": "8*sin(300*t)"})


SPRING = oscillator("k*d + c*v", name="spring", k=400.0, c=0.5)
NOISE = {"x:m1": 1e-5, "a:m1": 1.0}
DRIVE = "--force m1=5 --noise x:m1=1e-5"


@pytest.fixture(scope="module")
def found() -> BestTest:
    within = {"force": 20.0, "stroke:spring": 0.02}
    return lw.best_test(SPRING, "spring.k", duration=2.0, rate=60.0, noise=NOISE, within=within)


def test_the_best_keeps_the_limits_and_its_error_is_that_of_limit(found: BestTest) -> None:
    """As an expression of t, not by its samples; of the linear structure errors halve where forces double."""
    best = found.plans[0]
    errors = [plan.error_of("spring.k") for plan in found.plans[1:]]
    assert best.error_of("spring.k") <= 1.1 * min(errors) and errors[2:] == sorted(errors[2:])
    assert all(plan.strokes["spring"] <= 0.02 and plan.peak <= 20.0 for plan in found.plans)
    assert list(best.limit.noise) == ["x:m1"]  # the accelerometer adds next to nothing
    bound = lw.limit(
        SPRING, duration=2.0, rate=60.0, noise={"x:m1": 1e-5}, sensors=["x:m1"], forces={"m1": best.force},
        segment=best.limit.segment,
    )  # fmt: skip
    assert bound.coefficient("spring.k").standard_error == pytest.approx(best.error_of("spring.k"), rel=1e-2)
    kind, band = found.plans[-1].kind, found.plans[-1].band
    alike = [
        plan for plan in found.plans if (plan.kind, plan.band) == (kind, band) and len(plan.limit.noise) == 2
    ]
    scaled = [plan.peak * plan.error_of("spring.k") for plan in alike]
    assert len(alike) > 1 and np.ptp(scaled) < 1e-3 * scaled[0]


def test_its_command_simulates_it(found: BestTest, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    lw.write_structure(SPRING, tmp_path / "structure.toml")
    printed = found.to_dict()["tests"][0]
    assert printed["command"] in str(found)
    said(shlex.join(shlex.split(printed["command"])[1:]))
    record = lw.read_record(tmp_path / "test.csv")
    assert np.abs(record.channel("force:m1")).max() <= 1.01 * printed["peak"]
    assert np.abs(record.channel("x:m1")).max() == pytest.approx(printed["strokes"]["spring"], rel=0.02)


def test_the_command_compares_tests_and_refuses_a_drive(tmp_path: Path) -> None:
    lw.write_structure(SPRING, tmp_path / "spring.toml")
    asked = f"limit {tmp_path}/spring.toml --duration 1 --rate 50 --optimise spring.c"
    printed = document(f"{asked} --within force=20 --noise x:m1=1e-5")
    assert printed["coefficient"] == "spring.c" and printed["tests"][0]["standard_error"] > 0.0
    assert f"simulate {tmp_path}/spring.toml" in printed["tests"][0]["command"]
    assert "it takes neither a drive nor --noise" in refusal(f"{asked} {DRIVE}")
    assert "the largest force" in refusal(f"{asked} --noise x:m1=1e-5")
    assert "spring, got stroke:leaf=1" in refusal(f"{asked} --within stroke:leaf=1 --noise x:m1=1e-5")
    tight = "--within force=20 --within stroke=1e-9 --noise x:m1=1e-5"
    assert "allow a larger stroke" in refusal(f"{asked} {tight}", 1)


SLOW = oscillator("k*d + k3*d**3 + c*v", mass=10.0, k=100.0, k3=2000.0, c=1.0)
"""Half a period a second, of which 0.25 s hold an eighth."""
RING_DOWN: dict[str, Any] = {"duration": 30.0, "rate": 50.0, "release": {"x:m1": 0.1}}
CHAOTIC: dict[str, Any] = {"duration": 6.0, "rate": 1000.0, "release": {"v:m1": 1.0}, "noise": 20.0}


@pytest.mark.slow
def test_a_slow_structure_has_the_bound_that_identify_reaches() -> None:
    """Of segments of 0.25 s the bound of the damping was 600 times as large."""
    limit = lw.limit(SLOW, noise=30.0, **RING_DOWN)
    assert limit.segment * 50.0 == pytest.approx(len(limit.record))
    assert "in one segment with a\nfree start" in str(limit)
    record = lw.simulate(SLOW, **RING_DOWN).with_noise(30.0, seed=5840021)
    fit = lw.identify(record, SLOW.unknown("all"))
    reached = [present(fit.coefficient(parameter.name).standard_error) for parameter in limit.parameters]
    # the noise is found from 1501 samples, to 1/sqrt(3002) = 1.8 %, and the bound is taken at the truth
    np.testing.assert_allclose(reached, limit.standard_errors, rtol=3 * 0.018)


@pytest.mark.slow
def test_chaotic_motion_has_shorter_segments_that_tell_more_than_the_shortest() -> None:
    chain = lw.bnes_chain(2)
    limit, short = (lw.limit(chain, unknown=["nes"], segment=segment, **CHAOTIC) for segment in (None, 0.25))
    assert limit.trusted and 0.25 < limit.segment < 6.0
    assert (limit.standard_errors < short.standard_errors).all()
    assert f"in segments of {limit.segment:g} s with free starts" in str(limit)
    clean = lw.simulate(chain, duration=6.0, rate=1000.0, release={"v:m1": 1.0})
    record = clean.with_noise(20.0, seed=5840022)
    fit = lw.identify(record, chain.unknown("nes"))
    reached = [present(fit.coefficient(parameter.name).standard_error) for parameter in limit.parameters]
    assert (np.array(reached) < limit.standard_errors).all()


@pytest.mark.slow
def test_segments_that_lose_what_shorter_ones_determine_and_too_low_a_rate_are_refused() -> None:
    """28 Hz at a sample in 20 s, of which steps as long as ten periods grew without end."""
    message = r"segments of 3 s are too long: .* what segments of 0\.25 s determine"
    with pytest.raises(lw.IdentificationError, match=message) as caught:
        lw.limit(lw.bnes_chain(2), unknown=["nes"], segment=3.0, **CHAOTIC)
    assert caught.value.arguments == ("segment",)
    with pytest.raises(lw.IdentificationError, match=r"0\.05 Hz are too few for the fastest") as caught:
        lw.limit(lw.bnes_chain(2), **{**CHAOTIC, "duration": 500.0, "rate": 0.05})
    assert caught.value.arguments == ("rate",)
