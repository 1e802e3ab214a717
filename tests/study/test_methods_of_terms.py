"""Methods that look for terms: discovery and SINDy, and how their answers are judged."""

import sys
from pathlib import Path

import pytest
from structures import link, named, structure, torsion_chain

import linkwise as lw
from linkwise.study.definition import parse_study
from linkwise.study.methods import DiscoveryMethod, PySindyMethod, SindyMethod, judged
from linkwise.study.subject import Subject

CHAIN = lw.bnes_chain(2)
HEAD = """
snr_db = [40]
[[structure]]
bnes = 2
duration = 1.0
rate = 500.0
release = { "v:m1" = 1.0 }
"""


@pytest.fixture(scope="module")
def subject() -> Subject:
    return Subject("chain", CHAIN, duration=1.0, rate=1000.0, release={"v:m1": 1.0})


@pytest.mark.slow
def test_discovery_is_told_the_masses_alone(subject: Subject) -> None:
    """Its answer is that of `discover`, and its terms and forces are the true ones."""
    clean = subject.simulate()
    result = DiscoveryMethod("discover").evaluate(subject, clean, snr_db=30.0, seed=5)
    discovery = lw.discover(subject.measured(clean).with_noise(30.0, seed=5), {"m1": 1.0, "m2": 0.01})
    assert discovery.trusted and result.status == "converged" and result.reason == ""
    assert result.terms == {"right": 5, "missing": 0, "extra": 0}
    k3 = discovery.structure.link("m2-m1").values["k3"]
    assert result.coefficients["m2-m1.k3"] == pytest.approx(k3, rel=1e-8)
    # %: the noise is 0.1 % of the motion, and a thousand samples are fitted
    assert 0.0 < result.links["nes1"] < 1e-2
    chain = Subject("torsion", torsion_chain(), duration=2.0, rate=500.0, release={"v:disc1": 6.0})
    turning = DiscoveryMethod("discover").evaluate(chain, chain.simulate(), snr_db=40.0, seed=5)
    assert turning.status == "converged" and turning.terms == result.terms


@pytest.mark.parametrize("between", ["m2-m1", "m1-m2"])
def test_a_link_is_judged_by_its_ends_in_either_order(between: str, subject: Subject) -> None:
    """The linear part of the sink is 1 % off, a damper too many to the ground, and a damper is missing."""
    answer = structure(
        {"m1": 1.0, "m2": 0.01},
        link("a", "m1-ground", "p*d", p=30000.0),
        link("b", between, "p*d + q*d**3 + r*v", p=-99.0, q=1e6, r=0.02),
        link("c", "m2-ground", "r*v", r=0.1),
    )
    links, terms = judged(answer, subject, subject.simulate())
    assert terms == {"right": 4, "missing": 1, "extra": 1}
    weaker = lw.bnes_chain(2, alpha=-99.0).link("nes1")
    assert links["nes1"] == pytest.approx(lw.nmse(CHAIN.link("nes1"), weaker, subject.simulate()), rel=1e-8)


def test_pysindy_is_named_where_it_is_missing(subject: Subject, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pysindy", None)  # as if it were not installed
    short = Subject("short", CHAIN, duration=0.01, rate=1000.0, release={"v:m1": 1.0})
    driven = Subject("driven", CHAIN, duration=1.0, rate=500.0, forces={"m1": "sin(30*t)"})
    for given, message in (
        (subject, r"need the library pysindy; .*'linkwise\[peers\]'"),
        (short, "11 samples are too few for smoothed differences over 11"),
        (driven, "take no inputs, and the record has force:m1"),
    ):
        with pytest.raises(lw.IdentificationError, match=message):
            PySindyMethod("peer").evaluate(given, given.simulate(), snr_db=40.0, seed=1)


@pytest.mark.parametrize("kind", ["discover", "sindy", "pysindy"])
def test_what_is_not_masses_on_links_is_refused(kind: str) -> None:
    joint = named("joint", "m1-ground", "bouc-wen", k=500.0, c=1.0, F=5.0, x0=5e-3, s=0.6)
    subject = Subject("joint", structure({"m1": 1.0}, joint), duration=1.0, rate=500.0, release={"v:m1": 1.0})
    (method,) = parse_study(f'{HEAD}[[method]]\nkind = "{kind}"', "s.toml", Path()).methods
    with pytest.raises(lw.LinkwiseError, match=f'methods of the kind "{kind}"'):
        method.evaluate(subject, subject.simulate(), snr_db=40.0, seed=1)


def test_tables_make_methods_and_documents_make_them_again() -> None:
    tables = {
        'kind = "discover"': DiscoveryMethod("discover"),
        'kind = "discover"\nname = "few"\nterms = "linear, d**3"': DiscoveryMethod("few", "linear, d**3"),
        'kind = "sindy"': SindyMethod("sindy, links"),
        'kind = "sindy"\nname = "cut"\nthreshold = 0.05': SindyMethod("cut", threshold=0.05),
        'kind = "pysindy"\nwindow = 15': PySindyMethod("pysindy", window=15),
        'kind = "sindy"\nlibrary = "monomials"\norder = 2\nregressor = "l1"\nderivative = "savgol"': None,
    }
    text = HEAD + "".join(f"[[method]]\n{table}\n" for table in tables)
    study = parse_study(text, "s.toml", Path())
    assert all(
        made == expected or expected is None
        for made, expected in zip(study.methods, tables.values(), strict=True)
    )
    assert study.methods[5].name == "sindy, monomials"
    documents = [study.method(method.name).document() for method in study.methods]
    kinds = " ".join(each["kind"] for each in documents)
    assert kinds == "discover discover sindy sindy pysindy sindy"
    assert "threshold" not in documents[5] and documents[3]["threshold"] == 0.05
