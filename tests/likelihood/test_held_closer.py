"""Terms that a model error hides: found where the motion is held closer to the laws."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from judged import masses
from problems import truth

import linkwise as lw

FRICTION = 0.01  # N, beside 0.1 N of the damper at its fastest


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    """The two-mass chain with friction in its bistable link."""
    chain = lw.bnes_chain(2)
    links = {link.name: link for link in chain.links}
    rough = replace(
        links["nes1"],
        law=lw.Law.parse("alpha*d + beta*d**3 + c*v + mu*sign(v)"),
        coefficients={**links["nes1"].coefficients, "mu": lw.Coefficient.number(FRICTION)},
    )
    structure = replace(chain, links=(links["spring1"], rough))
    return lw.simulate(structure, release={"v:m1": 1.0}, duration=2.0, rate=1000.0)


@pytest.mark.parametrize("seed", [0, 2])
def test_friction_that_a_model_error_hides_takes_trust_away(clean: lw.Record, seed: int) -> None:
    """The damper stood for it, 6 to 8 standard errors off, and nothing was said."""
    chain = lw.bnes_chain(2)
    fit = lw.identify(clean.with_noise(20.0, seed=seed), chain.unknown("nes"))
    number = [parameter.name for parameter in fit.parameters].index("nes1.c")
    off = fit.values[number] - truth(chain, chain.unknown("nes"))[number]
    assert off > 5.0 * np.sqrt(fit.covariance[number, number])
    assert fit.verdicts == (lw.Verdict.SYSTEMATIC_MISFIT,)
    assert fit.diagnosis[0].term == "sign(v)" and fit.diagnosis[0].where == "nes1"
    assert fit.diagnosis[0].size == pytest.approx(FRICTION, rel=0.05)  # linearised at the fit without it
    assert "a force like sign(v) in nes1" in fit.message and "change nes1.c by" in fit.message


def test_friction_that_was_not_offered_takes_trust_from_a_discovery(clean: lw.Record) -> None:
    discovery = lw.discover(clean.with_noise(20.0, seed=1), masses(lw.bnes_chain(2)))
    assert lw.Verdict.SYSTEMATIC_MISFIT in discovery.verdicts and not discovery.trusted
    assert discovery.diagnosis[0].term == "sign(v)"


@pytest.mark.parametrize("seed", [0, 1])
def test_forces_that_no_term_explains_remain_a_model_error(seed: int) -> None:
    """White forces on both masses, which no channel shows, beside the motion after a release."""
    chain, rng = lw.bnes_chain(2), np.random.default_rng(seed)
    forces = {
        mass: lw.model.Sampled(0.0, 1000.0, size * rng.normal(size=2001))
        for mass, size in (("m1", 5.0), ("m2", 0.05))
    }
    record = lw.simulate(chain, release={"v:m1": 1.0}, forces=forces, duration=2.0, rate=1000.0)
    fit = lw.identify(record.select(("x:m1", "x:m2")).with_noise(30.0, seed=seed), chain.unknown("nes"))
    assert fit.model_error > 0.0 and fit.verdicts == (lw.Verdict.MODEL_ERROR_NEEDED,)
