"""Laws that can be read and hardly be meant: simulated, or refused in words, without a warning."""

from __future__ import annotations

import numpy as np
import pytest

import linkwise as lw


def held_by(law: str) -> lw.Structure:
    """One mass of 1 kg, held by a link of this law whose coefficients are 1, 1.5, 2, ..."""
    parsed = lw.Law.parse(law)
    values = {name: lw.Coefficient.number(1.0 + 0.5 * k) for k, name in enumerate(parsed.coefficients)}
    link = lw.Link("l", ("m", lw.GROUND), parsed, values)
    return lw.Structure("one", (lw.Mass("m", lw.Coefficient.number(1.0)),), (link,))


@pytest.mark.parametrize("law", ["0*c", "d*0", "0", "k*d + 0*c", "c*d - c*d + k*v"])
def test_a_coefficient_that_cancels_changes_nothing(law: str) -> None:
    """heyoka refuses a parameter that its equations do not use."""
    release = {"x:m": 0.1, "v:m": 1.0}
    record = lw.simulate(held_by(law), release=release, duration=0.1, rate=200.0)
    if "k" not in law:  # no force: the mass flies on
        np.testing.assert_allclose(record.channel("x:m"), 0.1 + record.time, rtol=1e-12)


@pytest.mark.parametrize(
    "law",
    [
        "exp((v + k)**17)",
        "-1e6*v - 3",
        "exp(exp(exp(exp(v + 9))))",
        "((1e-3 + k)**3)**0.5*(k*p*min(d, 1e300))**p",
        "1/d",
        "log(d - 1)",
    ],
)
def test_a_force_that_is_not_finite_is_told(law: str) -> None:
    try:
        record = lw.simulate(held_by(law), release={"x:m": 0.1, "v:m": 1.0}, duration=0.05, rate=200.0)
        assert np.isfinite(record.values).all()
    except lw.LinkwiseError as error:
        assert "fault" not in str(error) and len(str(error)) < 1000
