"""Results in a notebook: escaped, self-contained, and with their trust in the first line."""

from dataclasses import replace

from problems import chain_record

import linkwise as lw


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


def test_records_and_unknown_masses_are_shown_and_long_structures_cut() -> None:
    record = chain_record(2, duration=0.5)
    assert "x:m1" in record._repr_html_() and "501 samples" in record._repr_html_()
    assert "unknown" in lw.bnes_chain(2).unknown("mass:m2")._repr_html_()
    assert [("more" in lw.bnes_chain(size)._repr_html_()) for size in (40, 60)] == [False, True]
