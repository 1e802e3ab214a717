"""What Python shows of the objects that a user holds fits a line or two."""

import sys

import numpy as np
import pytest

import linkwise as lw


def test_objects_show_themselves_in_a_line(fitted: lw.Estimate, discovered: lw.Discovery) -> None:
    shown = {
        "<Structure: bistable chain of 2 masses: 2 masses, 2 links>": fitted.structure,
        "<Estimate: bistable chain of 2 masses: weak, converged, can be trusted>": fitted,
        "<LinkEstimate: nes1 (m2 - m1): alpha*d + beta*d**3 + c*v>": fitted.link("nes1"),
        "<Posterior of 3 coefficients: nes1.alpha, nes1.beta, nes1.c>": lw.estimates.Posterior.of(fitted),
    }
    assert {text: repr(thing) for text, thing in shown.items()} == {text: text for text in shown}
    assert repr(discovered).startswith("<Discovery: 2 masses") and "\n" not in repr(discovered)
    assert str(fitted.structure).splitlines()[-1].endswith("m2 - m1  alpha*d + beta*d**3 + c*v")
    for thing in (fitted.motion, fitted.record.simulated, lw.study.read_study("paper")):
        assert len(repr(thing)) < 200


def test_an_estimate_is_a_table_of_pandas(fitted: lw.Estimate, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pandas")
    table = fitted.to_dataframe()
    alpha = fitted.coefficient("nes1.alpha")
    assert alpha.interval is not None
    assert tuple(table.loc["nes1.alpha"]) == (
        alpha.value,
        alpha.standard_error,
        *alpha.interval,
        "N/m",
        False,
    )
    assert np.isnan(table.loc["m1.mass", "lower"]) and list(table.index)[-1] == "m2.mass"
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(
        lw.IdentificationError, match="to_dataframe\\(\\) needs pandas, which is not installed: pip install"
    ):
        fitted.to_dataframe()


def test_a_posterior_is_a_chain_of_draws(fitted: lw.Estimate) -> None:
    chains = lw.estimates.Posterior.of(fitted).to_dict(4000, seed=1)
    assert list(chains) == ["nes1.alpha", "nes1.beta", "nes1.c"]
    alpha = fitted.coefficient("nes1.alpha")
    assert chains["nes1.alpha"].shape == (1, 4000) and alpha.standard_error is not None
    error = alpha.standard_error / np.sqrt(4000.0)
    assert abs(chains["nes1.alpha"].mean() - alpha.value) < 4.0 * error
