"""Maximum likelihood with hosts: fewer sensors than modes, priors, and modes, shapes or damping that are off or lacking."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from present import present, some
from record_faults import without
from structures import (
    CANTILEVER,
    CANTILEVER_SHAPES,
    CANTILEVER_SINK,
    HARDENING,
    NES,
    Value,
    host,
    link,
    structure,
    with_links,
)
from within import assert_within, of

import linkwise as lw

pytestmark = pytest.mark.slow


number = lw.Coefficient.number
SINK_OF_BEAM = of("nes", CANTILEVER_SINK)


def beam(frequencies: Sequence[lw.Coefficient | float] = CANTILEVER, end: str = "tip") -> lw.Structure:
    """A cantilever by three modes with a bistable sink at one of its points."""
    sink = link("nes", f"sink-beam.{end}", NES, **CANTILEVER_SINK)
    return structure(
        {"sink": 0.03}, sink, hosts=[host("beam", frequencies, 0.01, CANTILEVER_SHAPES)], name="beam"
    )


@cache
def record() -> lw.Record:
    return hit(beam())


def hit(subject: lw.Structure) -> lw.Record:
    """Two hammer hits; accelerometers on two points and on the sink, fewer than the three modes and the sink."""
    hits = "80*exp(-((t - 0.05)/0.002)**2) + 60*exp(-((t - 0.675)/0.002)**2)"
    return lw.simulate(
        subject,
        forces={"beam.mid": hits},
        release={"x:sink": 0.00707},
        duration=1.25,
        rate=1000.0,
        sensors=["a:beam.tip", "a:beam.root", "a:sink"],
    ).with_noise(25.0, seed=42)


def first_hit() -> lw.Record:
    """The first 0.25 s, with the first of them: a wrong law or shape costs a long search, which more samples prolong."""
    return record()[:251]


@cache
def with_exact_host() -> lw.Estimate:
    return lw.identify(record(), beam().unknown("nes"))


def test_a_sink_on_a_beam_is_identified_with_fewer_sensors_than_modes() -> None:
    fit = with_exact_host()
    assert_within(fit, SINK_OF_BEAM)
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=0.08)
    assert [link["name"] for link in fit.to_dict()["links"]] == ["nes"]


def test_frequencies_known_to_within_are_found() -> None:
    within = tuple(
        lw.Coefficient.unknown(frequency * factor, sigma=0.01 * frequency)
        for frequency, factor in zip(CANTILEVER, (1.01, 0.992, 1.004), strict=True)
    )
    fit = lw.identify(record(), beam(within).unknown("nes"))
    assert_within(fit, SINK_OF_BEAM)
    frequencies = {f"beam.mode{r}.frequency": true for r, true in enumerate(CANTILEVER, start=1)}
    assert_within(fit, frequencies)
    for name, true in frequencies.items():  # the prior: the record adds to what is stated
        assert present(fit.coefficient(name).standard_error) < 0.01 * true
    assert fit.to_dict()["modes"][0]["frequency"]["unit"] == "Hz"


def test_a_wrong_frequency_held_as_known_is_not_trusted_and_named() -> None:
    wrong = tuple(number(frequency * (1.03 if r == 1 else 1.0)) for r, frequency in enumerate(CANTILEVER))
    fit = lw.identify(first_hit(), beam(wrong).unknown("nes"), as_stated=True)
    assert not fit.trusted
    assert (fit.diagnosis[0].kind, fit.diagnosis[0].where) == ("frequency", "beam.mode2")
    # a linearisation, with 3 % far outside the noise
    assert fit.diagnosis[0].size == pytest.approx(-0.03, abs=0.015)


def test_a_wrong_shape_is_named() -> None:
    """The tip moves with the first mode 5 % more than is stated: the stated shape is 4.8 % short of it."""
    wrong = beam()
    modes = [
        replace(mode, shape={**mode.shape, "tip": mode.shape["tip"] / 1.05}) if number == 1 else mode
        for number, mode in enumerate(wrong.hosts[0].modes)
    ]
    fit = lw.identify(
        first_hit(), beside(wrong, replace(beam().hosts[0], modes=tuple(modes))), as_stated=True
    )
    assert not fit.trusted
    assert ("shape", "beam.tip", "beam.mode2") in [
        (cause.kind, cause.where, cause.source) for cause in fit.diagnosis[:2]
    ]


def test_a_mode_that_the_samples_hardly_tell_leaves_intervals_and_diagnosis() -> None:
    """Its states are lost in rounding beside those of the slow modes, above half of the sampling rate of 500 Hz."""
    shapes = {"tip": (1.0, -1.0, 0.3), "joint": (0.62, 0.3, 0.2)}
    true = {"k": 200.0, "k3": 2e6, "c": 0.05}
    payload = link("payload", "store-wing.tip", HARDENING, **true)
    wing = structure({"store": 0.05}, payload, hosts=[host("wing", (5.2, 21.0, 450.0), 0.01, shapes)])
    recorded = lw.simulate(
        wing, forces={"wing.joint": "5*sin(33*t)"}, release={"v:wing.mode1": 0.3}, duration=1.0, rate=500.0
    ).with_noise(40.0, seed=3)
    fit = lw.identify(recorded, wing.unknown("payload"))
    assert_within(fit, of("payload", true))
    for name, value in true.items():
        assert present(fit.coefficient(f"payload.{name}").standard_error) < 0.05 * abs(value)
    heavy = structure({"store": 0.055}, payload, hosts=wing.hosts).unknown("payload")
    wrong = lw.identify(recorded[:201], heavy, as_stated=True)  # of a wrong mass 0.4 s show enough
    assert not wrong.trusted
    assert (wrong.diagnosis[0].kind, wrong.diagnosis[0].where) == ("mass", "store")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda whole: without(whole, **{"force:beam.mid": 10}), "channel force:beam.mid: 1 of"),
        (
            lambda whole: replace(whole, channels=("a:beam.tup", *whole.channels[1:])),
            "channel a:beam.tup belongs to no mass or point of the structure",
        ),
        (lambda whole: whole[:8], "8 samples, too few to determine the motion of a host"),
    ],
)
def test_records_without_start_are_refused(change: Callable[[lw.Record], lw.Record], message: str) -> None:
    with pytest.raises((lw.IdentificationError, lw.RecordError), match=message):
        lw.identify(change(record()), beam().unknown("nes"))


def test_structures_that_tell_no_start_are_refused() -> None:
    shaker = link("shaker", "beam.mid-base", "k*d", k=10.0)
    with pytest.raises(lw.IdentificationError, match="moving base beside a host"):
        lw.identify(record(), with_links(beam().unknown("nes"), shaker))
    open_mode = (lw.Coefficient.unknown(), *map(number, CANTILEVER[1:]))
    with pytest.raises(lw.IdentificationError, match=r"no starting value for beam\.mode1\.frequency"):
        lw.identify(record(), beam(open_mode).unknown("nes"))


def beside(subject: lw.Structure, host: lw.Host) -> lw.Structure:
    """The structure with another host of the same points and the sink unknown."""
    return structure({"sink": 0.03}, subject.unknown("nes").link("nes"), hosts=[host], name="beam")


def mistaken(seed: int, part: float = 0.02) -> lw.Host:
    """The host with shapes that are off by normal errors of this part of the largest of the mode."""
    rng, modes = np.random.default_rng(seed), []
    for mode in beam().hosts[0].modes:
        size = part * max(map(abs, mode.shape.values()))
        shape = {point: value + size * rng.standard_normal() for point, value in mode.shape.items()}
        modes.append(replace(mode, shape=shape))
    return replace(beam().hosts[0], modes=tuple(modes))


def test_shapes_known_to_within_are_found_and_counted() -> None:
    """Shapes off by 2 %, known to within, come out."""
    fit = lw.identify(record(), beside(beam(), mistaken(101).known_to_within(shape=0.02)))
    assert_within(fit, SINK_OF_BEAM)
    assert fit.chi_square_per_sample == pytest.approx(1.0, abs=0.08)
    assert len(fit.shapes) == 9
    assert_within(fit, {shape.name: present(beam().coefficient(shape.name).value) for shape in fit.shapes})
    for shape in fit.shapes:
        assert present(shape.standard_error) < 0.02 * 3.21  # the prior of the largest; the record adds to it
    (first, *_) = fit.to_dict()["modes"]
    assert first["shape"]["tip"]["unit"] == "1/sqrt(kg)"
    assert fit.structure.coefficient("beam.mode1.shape.tip").value == first["shape"]["tip"]["value"]
    assert "... and 3 more" in str(fit)
    known = with_exact_host()
    for name in CANTILEVER_SINK:
        wide, narrow = (present(one.coefficient(f"nes.{name}").standard_error) for one in (fit, known))
        assert wide > narrow


def test_a_prior_of_a_shape_that_the_record_contradicts_is_named() -> None:
    modes = beam().hosts[0].modes
    wrong = replace(
        modes[1], shape={**modes[1].shape, "tip": 1.05 * modes[1].shape["tip"]}, shape_sigma={"tip": 0.01}
    )
    host = replace(beam().hosts[0], modes=(modes[0], wrong, *modes[2:]))
    fit = lw.identify(record(), beside(beam(), host), as_stated=True)
    assert not fit.trusted
    assert ("prior", "beam.mode2.shape.tip") in [(cause.kind, cause.where) for cause in fit.diagnosis]


def test_the_frequency_of_a_mode_that_noise_hides_keeps_its_prior() -> None:
    """The likelihood has several peaks within the prior, of which the curvature of one says too little."""
    hidden = lw.model.HostMode(number(180.0), number(0.01), {"tip": 0.3, "mid": 0.12, "root": 0.1})
    true = beside(beam(), replace(beam().hosts[0], modes=(*beam().hosts[0].modes, hidden))).with_values(
        {f"nes.{name}": value for name, value in CANTILEVER_SINK.items()}
    )
    shown = hit(true)
    fit = lw.identify(shown, beside(true, true.hosts[0].known_to_within(frequency=0.01)))
    assert_within(fit, SINK_OF_BEAM)
    assert fit.coefficient("beam.mode4.frequency").standard_error == pytest.approx(1.8)
    assert any("beam.mode4.frequency is hardly determined" in finding for finding in fit.findings)
    # Hz, where the prior of 1 % has 0.58
    assert present(fit.coefficient("beam.mode3.frequency").standard_error) < 0.1


def test_covariances_do_not_rest_on_rounding() -> None:
    """Where all links are linear the smoothed states are far more certain than the samples: starts gave any covariance."""
    beam = host("beam", [5.2], 0.01, {"tip": [1.0]}).known_to_within(frequency=0.01)
    subject = structure(
        {"ball": 0.05}, link("sink", "ball-beam.tip", "k*d + c*v", k=50.0, c=0.3), hosts=[beam]
    )
    record = lw.simulate(subject, release={"v:beam.mode1": 0.5}, duration=4.0, rate=200.0)
    noisy, asked = record.with_noise(30.0, seed=12), subject.unknown("sink")
    first, second = (
        lw.identify(noisy, asked, starts={"sink.k": k, "sink.c": c}) for k, c in ((50.0, 0.3), (52.0, 0.35))
    )
    assert first.trusted and second.trusted
    assert first.covariance == pytest.approx(second.covariance, rel=0.01)


WING = {"tip": [0.6, 0.5], "mid": [0.4, -0.5]}
JOINT = "k3*d**3 + c*v"
TWO, DAMPING = [5.0, 12.0], 0.01
FREQUENCY_SIGMA, DAMPING_SIGMA = 0.24, 0.003


def answer(highest: float) -> lw.Estimate:
    """From a sweep of the first mode, or up to the second, to a link on a host of which little is known."""
    wing = structure(
        {}, link("joint", "wing.tip-ground", JOINT, k3=2e4, c=0.05), hosts=[host("wing", TWO, DAMPING, WING)]
    )
    record = lw.simulate(
        wing,
        forces={"wing.mid": f"5*sin(2*pi*(2*t + {(highest - 2.0) / 16.0}*t**2))"},
        duration=8.0,
        rate=200.0,
        sensors=["a:wing.tip"],
    ).with_noise(20.0, seed=5204203)
    frequencies = [lw.Coefficient.unknown(frequency + 0.1, sigma=FREQUENCY_SIGMA) for frequency in TWO]
    damping = [lw.Coefficient.unknown(0.7 * DAMPING, sigma=DAMPING_SIGMA)] * 2
    unknown = structure(
        {}, link("joint", "wing.tip-ground", JOINT), hosts=[host("wing", frequencies, damping, WING)]
    )
    return lw.identify(record, unknown)


def test_a_hidden_mode_keeps_what_is_known_of_it_and_one_that_is_swept_is_told_from_noise() -> None:
    hidden, swept = answer(10.0), answer(14.0)
    assert hidden.trusted and swept.trusted
    errors = [hidden.coefficient(f"wing.mode2.{name}").standard_error for name in ("frequency", "damping")]
    assert errors == pytest.approx([FREQUENCY_SIGMA, DAMPING_SIGMA], rel=1e-12)
    [remark] = [text for text in hidden.remarks if "noise hides" in text]
    assert remark.startswith("wing.mode2.frequency and wing.mode2.damping are hardly determined")
    assert not [text for text in swept.remarks if "noise hides" in text]
    assert present(swept.coefficient("wing.mode2.frequency").standard_error) < 0.1 * FREQUENCY_SIGMA


FOUR = (3.3, 20.6, 57.7, 113.0)
OF_FOUR = {"tip": (3.2, -3.2, 3.2, -3.2), "mid": (1.1, 2.3, 0.06, -2.2), "root": (0.3, 1.5, 2.8, 2.5)}
SINK = {"k": 200.0, "k3": 2e6, "c": 0.05}
ACCELEROMETERS = ("a:beam.tip", "a:beam.mid", "a:beam.root", "x:sink")


def _beam(modes: Sequence[int], off: float = 1.0, **values: float) -> lw.Structure:
    """A cantilever by some of its modes, with a hardening sink at its tip; the second frequency is `off` by a factor."""
    frequencies = [FOUR[r] * (off if r == 1 else 1.0) for r in modes]
    shapes = {point: [shape[r] for r in modes] for point, shape in OF_FOUR.items()}
    beam = host("beam", frequencies, 0.01, shapes)
    return structure(
        {"sink": 0.03}, link("nes", "beam.tip-sink", HARDENING, **values), hosts=[beam], name="beam"
    )


def _hit(subject: lw.Structure, sensors: Sequence[str], seed: int, duration: float = 1.0) -> lw.Record:
    """A hit near the root."""
    hit = "3*exp(-((t - 0.1)/0.003)**2)"
    record = lw.simulate(subject, forces={"beam.root": hit}, duration=duration, rate=1000.0, sensors=sensors)
    return record.with_noise(30.0, seed=seed)


def test_a_mode_that_a_host_lacks_is_named_by_its_frequency() -> None:
    recorded = _hit(_beam((0, 1, 2, 3), **SINK), ACCELEROMETERS, 5215401)
    fit = lw.identify(recorded, _beam((0, 1, 2)), as_stated=True)
    cause = fit.diagnosis[0]
    assert not fit.trusted and (cause.kind, cause.where) == ("mode", "beam")
    # a peak as wide as the damping, 1 % to either side, whose neighbours are stated
    assert cause.size == pytest.approx(FOUR[3], rel=0.01)
    assert f"a mode near {cause.size:.3g} Hz that the host beam lacks" in fit.message
    assert fit.fit_verdicts == (lw.Verdict.UNEXPLAINED_FORCES,)


def test_a_link_that_moves_a_mode_is_no_mode_that_is_lacking() -> None:
    """The sensors then lack the stated mode, which they should show."""
    true = _beam((0, 1, 2), **SINK)
    spring = link("ground", "beam.mid-ground", "k*d", k=3000.0)
    stiffer = structure({"sink": 0.03}, *true.links[-1:], spring, hosts=true.hosts, name="beam")
    fit = lw.identify(_hit(stiffer, ACCELEROMETERS, 5215406), _beam((0, 1, 2)), as_stated=True)
    assert not fit.trusted and fit.diagnosis[0].kind == "link"
    assert "mode" not in {cause.kind for cause in fit.diagnosis}


TRUE = {"k": 500.0, "k3": 5e6, "c": 0.2}


def body(**law: float) -> lw.Structure:
    """A free body with one mode that bends, and a sink on it."""
    free = host("body", (0.0, 20.0), 0.01, {"left": (1.2, 1.5), "mid": (1.2, -1.0)})
    return structure({"sink": 0.05}, link("nes", "sink-body.mid", "k*d + k3*d**3 + c*v", **law), hosts=[free])


def pushed(kind: str) -> lw.Record:
    return lw.simulate(
        body(**TRUE),
        forces={"body.left": "6*sin(2*pi*15*t + 40*t**2)*exp(-t)"},
        duration=1.5,
        rate=500.0,
        sensors=[f"{kind}:{place}" for place in ("body.left", "body.mid", "sink")],
    ).with_noise(40.0, seed=11)


def test_displacements_tell_the_place_of_a_free_body() -> None:
    found = lw.identify(pushed("x"), body(**TRUE).unknown("nes"))
    assert_within(found, of("nes", TRUE))


@pytest.mark.parametrize(("kind", "mount"), [("v", []), ("a", []), ("a", ["c*v"])])
def test_what_does_not_tell_its_place_is_refused(kind: str, mount: Sequence[str]) -> None:
    """Velocities and accelerations, which are not told by a damper to the ground either."""
    mounted = with_links(body(**TRUE), *(link("mount", "body.left-ground", law, c=0.3) for law in mount))
    with pytest.raises(lw.IdentificationError, match="nothing tells the place of rigid motions at 0 Hz"):
        lw.identify(pushed(kind), mounted.unknown("nes"))


FREQUENCIES, RATIO = (5.0, 6.5, 11.0), 0.012
SHAPES = {"tip": (0.8, -0.6, 0.9), "joint": (0.5, 0.7, -0.4)}
PAYLOAD = {"k": 320.0, "k3": 2e6, "c": 0.2}
BETWEEN = 0.5  # N s/m, of 0.86 N s/m at most, with which no motion gains energy

# Hz
TONES = [(3.1, 0.4), (4.6, 2.1), (5.3, 5.0), (6.2, 1.1), (6.9, 3.3), (8.4, 0.2), (10.6, 4.4), (12.1, 2.6)]
FORCE = " + ".join(f"0.4*sin({2.0 * np.pi * frequency}*t + {phase})" for frequency, phase in TONES)


def wing(between: Mapping[tuple[int, int], Value] | None = None) -> lw.Structure:
    payload = link("payload", "store-wing.tip", "k*d + k3*d**3 + c*v", **PAYLOAD)
    return structure({"store": 0.08}, payload, hosts=[host("wing", FREQUENCIES, RATIO, SHAPES, between)])


@cache
def damped(between: float) -> lw.Record:
    return lw.simulate(
        wing({(1, 2): between} if between else None),
        forces={"wing.joint": FORCE},
        duration=2.0,
        rate=250.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(25.0, seed=811)


def test_damping_that_a_host_lacks_is_not_trusted_and_named() -> None:
    fit = lw.identify(damped(BETWEEN), wing().unknown("payload"), as_stated=True)
    assert fit.verdicts == (lw.Verdict.MEASUREMENT_ERROR,)
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.unit) == ("damping between modes", "wing.mode1+mode2", "N s/m")
    assert 'damping = [ { modes = [1, 2], damping = "unknown" } ] of that host' in fit.message
    # to first order, of a damping that is half of that of the modes
    assert cause.size == pytest.approx(BETWEEN, rel=0.3)


def test_as_the_diagnosis_says_the_damping_is_found_and_where_none_is_lacking_none_is_told() -> None:
    fit = lw.identify(damped(BETWEEN), wing({(1, 2): lw.Coefficient.unknown()}).unknown("payload"))
    assert_within(fit, {"wing.mode1+mode2.damping": BETWEEN, "payload.c": PAYLOAD["c"]})
    without = lw.identify(damped(0.0), wing().unknown("payload"))
    assert without.verdicts == (lw.Verdict.CONVERGED,) and not without.diagnosis


def test_damping_that_one_sensor_and_one_tone_do_not_rule_out_is_told() -> None:
    """A short record of one tone at one point: damping between modes may make a part of that of the payload."""
    tone = lw.simulate(
        wing(),
        forces={"wing.joint": f"0.4*sin({2.0 * np.pi * 5.1}*t)"},
        duration=3.0,
        rate=250.0,
        sensors=["a:wing.tip", "a:wing.joint", "a:store"],
    ).with_noise(20.0, seed=812)
    asked = wing().unknown("payload")
    at_one_point = tone.select(["a:wing.tip", "force:wing.joint"])
    values = asked.link("payload").coefficients
    positive = {**values, "k": replace(values["k"], lower=0.0)}  # about the middle
    fit = lw.identify(at_one_point, with_links(asked, replace(asked.link("payload"), coefficients=positive)))
    assert fit.trusted
    told = [term for term in fit.unseen_terms if term.link == "wing.mode1+mode2"]
    for term in some(told):
        assert term.term == "v" and 0.0 < term.share <= 1.0 and term.standard_errors > 3.0
        assert "damping between the modes 1 and 2 of wing" in term.description


AIRCRAFT = {
    "exc": (0.024, 0.018, 0.037, 0.019),
    "wing": (0.034, 0.031, 0.077, 0.067),
    "pay": (0.032, 0.027, 0.074, 0.058),
}
SLIP = "k*d + F*z", {"z": "(v - 0.5*abs(v)*z - 0.5*v*abs(z))/x0"}


def aircraft(*links: lw.Link, known: bool = True) -> lw.Structure:
    """A wing by four modes, all of it known, or to within what a test at a low level gives."""

    def within(value: float, part: float) -> lw.Coefficient:
        return number(value) if known else lw.Coefficient.unknown(value, sigma=part * value)

    modes = [
        lw.model.HostMode(
            within(frequency, 0.005),
            within(damping, 0.2),
            {point: shape[mode] for point, shape in AIRCRAFT.items()},
            {} if known else {point: 0.01 * shape[mode] for point, shape in AIRCRAFT.items()},
        )
        for mode, (frequency, damping) in enumerate(((3.5, 0.015), (5.2, 0.008), (7.3, 0.005), (9.2, 0.007)))
    ]
    return structure({}, *links, hosts=[lw.Host("ac", tuple(modes))])


def test_laws_that_leave_much_more_than_the_noise_of_quiet_sensors_are_fitted_beside_what_they_leave(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Beside noise of a thousandth what is known of the modes counts for nothing, and the search creeps."""
    samples, law = 600, lw.Law.parse(*SLIP)
    spectrum = np.fft.rfft(np.random.default_rng(1).standard_normal(samples))
    spectrum[(np.arange(len(spectrum)) < 12) | (np.arange(len(spectrum)) > 84)] = 0.0  # 2 to 14 Hz
    force = np.fft.irfft(spectrum, samples)
    record = lw.simulate(
        aircraft(
            link("joint", "ac.wing-ground", law, k=-2e4, F=20.0, x0=1e-3),
            link("gap", "ac.pay-ground", "k2*d*abs(d)", k2=3e6),
        ),
        forces={"ac.exc": lw.model.Sampled(0.0, 100.0, 80.0 * force / force.std(), band_limited=True)},
        duration=(samples - 1) / 100.0,
        rate=100.0,
        sensors=[f"a:ac.{point}" for point in AIRCRAFT],
    ).with_noise(60.0, seed=2)
    starts = {
        name: lw.Coefficient.unknown(start, lower=lower)
        for name, start, lower in (("k", -1e4, -np.inf), ("F", 20.0, 0.0), ("x0", 2e-3, 1e-6))
    }
    asked = aircraft(link("joint", "ac.wing-ground", law, **starts), known=False)
    monkeypatch.setattr("linkwise.likelihood.search.with_model_error", lambda *_: None)  # none is found
    fit = lw.identify(record, asked, as_stated=True)
    assert fit.grade is lw.Grade.APPROXIMATE and fit.verdicts == (lw.Verdict.NOISE_MISMATCH,)
    assert present(fit.chi_square_per_sample) > 30.0 and present(fit.coefficient("joint.k").value) < 0.0
    for mode, frequency in enumerate((3.5, 5.2, 7.3, 9.2), start=1):
        found = fit.coefficient(f"ac.mode{mode}.frequency")
        assert abs(present(found.value) - frequency) < 4.0 * present(found.standard_error) < 0.03 * frequency
    monkeypatch.setattr("linkwise.likelihood.search.with_noise_from_misfit", lambda *_: None)
    assert lw.identify(record, asked, as_stated=True).grade is lw.Grade.REFUSED
