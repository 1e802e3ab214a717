"""A sink whose mass no sensor of displacement shows, in small motion about one of its wells: the well is the right one."""

from __future__ import annotations

import numpy as np
import pytest
from structures import CANTILEVER, CANTILEVER_SHAPES, NES, host, link, structure

import linkwise as lw
from linkwise.likelihood.hidden_wells import _HiddenLink, _moves_of_rest, _place_of_rest, fit_about_rest
from linkwise.likelihood.options import LikelihoodOptions

SINK = {"alpha": -60.0, "beta": 2e6, "c": 0.1}
WELL = (60.0 / 2e6) ** 0.5  # m
ACCELEROMETERS = ("a:beam.tip", "a:beam.mid", "a:beam.root")


def _beam(mass: float | lw.Coefficient, **values: float) -> lw.Structure:
    """A cantilever of three modes with a bistable sink at its tip."""
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    return structure({"sink": mass}, link("nes", "beam.tip-sink", NES, **values), hosts=[beam], name="beam")


def _hit(
    well: float,
    seed: int,
    sensors: tuple[str, ...] = ACCELEROMETERS,
    *,
    force: float = 3.0,
    snr: float = 30.0,
) -> lw.Record:
    """Two hits of a force in N that leave the sink in a well of the link, in m."""
    hits = f"{force}*exp(-((t - 0.1)/0.003)**2) + {0.8 * force}*exp(-((t - 1.1)/0.003)**2)"
    return lw.simulate(
        _beam(0.03, **SINK),
        forces={"beam.root": hits},
        release={"x:sink": -well},
        duration=1.8,
        rate=1000.0,
        sensors=sensors,
    ).with_noise(snr, seed=seed)


@pytest.mark.parametrize(
    ("well", "mass", "seed"),
    [
        (WELL, 0.03, 5205201),
        (-WELL, 0.03, 5205202),
        (WELL, lw.Coefficient.unknown(start=0.025), 5205203),
    ],
)
def test_the_well_in_which_a_hidden_mass_rests_is_identified(
    well: float, mass: float | lw.Coefficient, seed: int
) -> None:
    fit = lw.identify(_hit(well, seed), _beam(mass))
    assert fit.trusted
    for name, true in SINK.items():
        coefficient = fit.coefficient(f"nes.{name}")
        assert coefficient.standard_error is not None
        # four standard errors: 6e-5 of chance each
        assert abs(coefficient.value - true) < 4.0 * coefficient.standard_error, name
    lower, upper = fit.link("nes").d_range
    assert lower < well < upper and not lower < -well < upper


@pytest.mark.parametrize(
    ("well", "force", "snr", "seed"),
    [(WELL, 0.3, 30.0, 5215201), (-WELL, 1.0, 20.0, 5215202), (-WELL, 2.0, 25.0, 5215203)],
)
def test_the_well_of_a_motion_in_which_the_law_hardly_bends_is_the_likelier_one(
    well: float, force: float, snr: float, seed: int
) -> None:
    """A law of one well leaves about as much noise, and its fit ends first."""
    fit = lw.identify(_hit(well, seed, force=force, snr=snr), _beam(0.03))
    assert fit.trusted
    for name, true in SINK.items():
        coefficient = fit.coefficient(f"nes.{name}")
        assert coefficient.standard_error is not None
        assert abs(coefficient.value - true) < 4.0 * coefficient.standard_error, name


def test_a_motion_that_tells_no_well_is_not_trusted_and_names_what_it_does_not_tell() -> None:
    """At 20 dB noise hides by how much springs of a hardening link and of one in a well differ in so small a motion."""
    fit = lw.identify(_hit(-WELL, 5215204, force=0.2, snr=20.0), _beam(0.03))
    assert fit.fit_verdicts == (lw.Verdict.SEVERAL_OPTIMA,) and not fit.trusted
    assert "nes.alpha and nes.beta are hardly determined" in fit.message
    assert any(remark.startswith("Another set of values explains the records") for remark in fit.remarks)


def test_the_well_of_a_mass_of_a_chain_with_accelerometers_is_identified() -> None:
    chain = structure(
        {"m1": 1.0, "m2": 0.03},
        link("base", "m1-ground", "k*d + c*v", k=400.0, c=0.5),
        link("nes", "m1-m2", NES, **SINK),
    )
    hit = "2*exp(-((t - 0.1)/0.01)**2)"
    record = lw.simulate(
        chain, forces={"m1": hit}, release={"x:m2": -WELL}, duration=2.5, rate=500.0, sensors=("a:m1", "a:m2")
    ).with_noise(25.0, seed=5215205)
    fit = lw.identify(record, chain.unknown("nes"))
    assert fit.trusted
    for name, true in SINK.items():
        coefficient = fit.coefficient(f"nes.{name}")
        assert coefficient.standard_error is not None
        assert abs(coefficient.value - true) < 4.0 * coefficient.standard_error, name


def test_a_fit_that_knows_a_bending_link_well_has_no_rival_about_another_rest() -> None:
    record, asked = _hit(WELL, 5215206), _beam(0.03)
    options = LikelihoodOptions(model_error=False)
    first = fit_about_rest([record], asked, options)
    assert first is not None and fit_about_rest([record], asked, options, first) is None


def test_only_links_that_alone_hold_an_unseen_mass_start_about_its_rest() -> None:
    options = LikelihoodOptions(model_error=False)
    shown = _hit(WELL, 5205204, ("a:beam.tip", "a:beam.mid", "x:sink"))
    assert fit_about_rest([shown], _beam(0.03), options) is None
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    linear = structure({"sink": 0.03}, link("nes", "beam.tip-sink", "k*d + c*v"), hosts=[beam], name="beam")
    assert fit_about_rest([_hit(WELL, 5205204)], linear, options) is None


def test_a_known_coefficient_stays() -> None:
    fit = fit_about_rest([_hit(-WELL, 5205205)], _beam(0.03, beta=2e6), LikelihoodOptions(model_error=False))
    assert fit is not None and not fit.chi_square_off
    values = dict(zip(("alpha", "c"), fit.values, strict=True))
    errors = np.sqrt(fit.covariance.diagonal())
    assert np.all(np.abs(np.array([values["alpha"] + 60.0, values["c"] - 0.1])) < 4.0 * errors)


def test_places_where_a_law_has_no_force_are_passed_over() -> None:
    """A link of two rods, whose force ends at their length, regressed at elongations beyond it."""
    law = "k*d*(1 - a/sqrt(0.01 - d**2)) + c*v"
    rods = link("rods", "beam.tip-sink", law, a=0.05, c=0.1)
    d = 0.01 * np.sin(np.arange(500) / 10.0)
    with np.errstate(invalid="ignore"):
        place, values = _place_of_rest(rods, {"k": 100.0}, d, 0.0 * d, 50.0 * d, {"k": "rods.k"})
    assert np.isfinite(place) and np.isfinite(values["k"])


def test_a_place_of_rest_moves_with_the_values_on_a_base_too() -> None:
    """Accelerometers on a moving base ended in an error that its motion was not given."""
    store = link("store", "m1-base", "k*d + k3*d**3", k=-100.0, k3=1e6)  # wells at 10 mm
    held = structure({"m1": 1.0}, store).unknown("all")
    around = 0.01 + 1e-3 * np.sin(np.arange(50.0))[None]
    before, after = np.array([-100.0, 1e6]), np.array([-144.0, 1e6])
    moves = _moves_of_rest(held, (_HiddenLink(0, 0, 1.0),), around, before, after)
    # from sqrt(100 / 1e6) to sqrt(144 / 1e6)
    assert moves == pytest.approx([0.002], abs=1e-8)
