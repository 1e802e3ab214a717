"""A sink whose mass no sensor of displacement shows, in small motion about one of its wells: the well is the right one."""

from __future__ import annotations

import numpy as np
import pytest
from structures import CANTILEVER, CANTILEVER_SHAPES, NES, host, link, structure

import linkwise as lw
from linkwise.likelihood.hidden_wells import _place_of_rest, fit_about_rest
from linkwise.likelihood.options import LikelihoodOptions

SINK = {"alpha": -60.0, "beta": 2e6, "c": 0.1}
WELL = (60.0 / 2e6) ** 0.5  # m
ACCELEROMETERS = ("a:beam.tip", "a:beam.mid", "a:beam.root")


def _beam(mass: float | lw.Coefficient, **values: float) -> lw.Structure:
    """A cantilever of three modes with a bistable sink at its tip."""
    beam = host("beam", CANTILEVER, 0.01, CANTILEVER_SHAPES)
    return structure({"sink": mass}, link("nes", "beam.tip-sink", NES, **values), hosts=[beam], name="beam")


def _hit(well: float, seed: int, sensors: tuple[str, ...] = ACCELEROMETERS) -> lw.Record:
    """Two hits that leave the sink in a well of the link, in m."""
    hits = "3*exp(-((t - 0.1)/0.003)**2) + 2.4*exp(-((t - 1.1)/0.003)**2)"
    return lw.simulate(
        _beam(0.03, **SINK),
        forces={"beam.root": hits},
        release={"x:sink": -well},
        duration=2.5,
        rate=1000.0,
        sensors=sensors,
    ).with_noise(30.0, seed=seed)


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
