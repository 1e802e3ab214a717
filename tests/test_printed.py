"""What Python and a notebook show of the objects that a user holds."""

import re
import sys
from dataclasses import replace
from pkgutil import resolve_name

import numpy as np
import pytest

import linkwise as lw
from linkwise.display import FIGURES, JudgedView


def test_objects_show_themselves_in_a_line(fitted: lw.Estimate, discovered: lw.Discovery) -> None:
    shown = {
        "<Structure: bistable chain of 2 masses: 2 masses, 2 links>": fitted.structure,
        "<Estimate: bistable chain of 2 masses: weak, converged, can be trusted>": fitted,
        "<LinkEstimate: nes1 (m2 - m1): alpha*d + beta*d**3 + c*v>": fitted.link("nes1"),
        "<CoefficientEstimate: m1.mass = 1 kg, given>": fitted.coefficient("m1.mass"),
        "<Posterior of 3 coefficients: nes1.alpha, nes1.beta, nes1.c>": lw.estimates.Posterior.of(fitted),
    }
    assert {text: repr(thing) for text, thing in shown.items()} == {text: text for text in shown}
    assert re.fullmatch(
        r"nes1.alpha = -[\d.]+ N/m, standard error [\d.]+", str(fitted.coefficient("nes1.alpha"))
    )
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
    message = "to_dataframe\\(\\) needs pandas, which is not installed: pip install"
    with pytest.raises(lw.IdentificationError, match=message):
        fitted.to_dataframe()


def test_results_draw_themselves(chain: lw.Structure, fitted: lw.Estimate, discovered: lw.Discovery) -> None:
    absorbed = lw.absorb(chain, duration=0.1, release={"v:m1": 1.0})
    for result in (fitted, discovered, absorbed, lw.inspect(fitted.record)):
        assert result.plot().axes

    class Table(JudgedView):
        verdicts = ()

    with pytest.raises(TypeError, match="Table has no figure of its own: print it"):
        Table().plot()
    assert all(callable(resolve_name(home)) for home in FIGURES.values())


def heading(markup: str) -> str:
    return markup.partition("<strong>")[2].partition("</strong>")[0]


def test_an_estimate_shows_its_trust_first(fitted: lw.Estimate) -> None:
    good = fitted._repr_html_()
    bad = replace(fitted, fit_verdicts=(lw.Verdict.NOT_CONVERGED,))._repr_html_()
    assert heading(good).endswith("can be trusted") and "#1a7f37" in good and "alpha" in good
    assert heading(bad).endswith("NOT to be trusted") and "#b42318" in bad


def test_other_answers_show_their_text(chain: lw.Structure, discovered: lw.Discovery) -> None:
    planned = lw.limit(chain, release={"v:m1": 1.0}, duration=0.1, rate=1000.0, noise=20.0)
    absorbed = lw.absorb(chain, duration=0.1, release={"v:m1": 1.0})
    for result in (discovered, planned, absorbed):
        markup = result._repr_html_()
        assert heading(markup) == str(result).splitlines()[0] and "<pre" in markup


def test_names_are_escaped(chain: lw.Structure) -> None:
    hostile = replace(chain, name="<script>alert(1)</script>")
    markup = hostile._repr_html_()
    assert "<script" not in markup and "&lt;script&gt;" in markup
    assert "alpha*d + beta*d**3 + c*v" in markup and "0.01 kg" in markup
