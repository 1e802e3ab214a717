"""Study files: what they say, what is filled in, and what each mistake is answered with."""

import json
import re
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest
from duffing_ring import SIZE, VALUES, motion, ring
from present import present, some
from small_study import TEXT, small

import linkwise as lw
from linkwise.study.definition import build_study, parse_study

STRUCTURE = '[[structure]]\nbnes = 2\nduration = 1.0\nrate = 500.0\nrelease = { "v:m1" = 1.0 }\n'
METHOD = '[[method]]\nkind = "weak"\n'
HEAD = "snr_db = [20]\n"
GOOD = HEAD + STRUCTURE + METHOD


def test_the_paper_ships_with_linkwise() -> None:
    paper = lw.study.read_study("paper")
    assert [subject.structure.size for subject in paper.subjects] == [2, 4, 6, 8, 10]
    assert paper.snr_db == (40.0, 30.0, 20.0) and paper.first_seed == 1000 and paper.cycles == 100
    assert {"physics-informed", "weak", "ml"} < {method.name for method in paper.methods}
    conventions = "displacement", "states", "differenced", "derivatives"
    assert {f"classical, {convention}" for convention in conventions} < {each.name for each in paper.methods}
    assert len(paper) == len(list(paper.cases())) == 5 * 3 * len(paper.methods) * 100
    assert paper.quickly().cycles == paper.quick == 5
    assert [subject.release for subject in paper.subjects] == [{"v:m1": 1.0}] + 4 * [{"v:m1": 3.0}]
    assert paper.subject("6 masses").judged_links == ("nes1", "nes2", "nes3")


def test_the_reach_of_discovery_ships_with_linkwise() -> None:
    """Chains with 1, 2 and 4 sinks and the ring, two lengths each, 5 to 50 samples a period, 8 to 40 dB."""
    reach = lw.study.read_study("reach")
    assert sorted(reach.snr_db) == [8.0, 16.0, 24.0, 32.0, 40.0]
    assert len(reach.subjects) == 4 * 2 * 4
    assert {subject.structure.size for subject in reach.subjects} == {2, 4, 8, 5}
    assert {round(present(subject.samples_per_period), 9) for subject in reach.subjects} == {5, 10, 25, 50}
    assert [method.document()["kind"] for method in reach.methods] == ["discover", "sindy", "sindy"]
    published = reach.subject("Duffing ring, 29.8 s, 5 Hz")
    assert len(published.simulate()) == 150
    assert lw.discovery.term_score(published.structure, ring(*VALUES.reshape(3, SIZE))).exact
    expected = motion(VALUES, np.ones(SIZE), np.zeros(SIZE))
    np.testing.assert_allclose(  # same numerics
        published.simulate().select(expected.channels).values, expected.values, rtol=0.0, atol=1e-8
    )


def test_lists_of_lengths_and_rates_are_structures_of_their_own() -> None:
    lists = "duration = [0.5, 1]\nrate = [100.0, 137.5]\nfrequency = 50.0"
    text = HEAD + STRUCTURE.replace("duration = 1.0\nrate = 500.0", lists)
    variant = '[[structure.variant]]\nname = "short"\nduration = 0.25\n'
    subjects = parse_study(text + variant + METHOD, "s.toml", Path()).subjects
    lengths = (("0.5 s", 0.5), ("1 s", 1.0), ("short", 0.25))
    expected = [
        (f"bnes2, {name}, {rate:g} Hz", duration, rate)
        for name, duration in lengths
        for rate in (100.0, 137.5)
    ]
    assert [(subject.name, subject.duration, subject.rate) for subject in subjects] == expected
    assert [subject.samples_per_period for subject in subjects[:2]] == [2.0, 2.75]
    (plain,) = parse_study(GOOD, "s.toml", Path()).subjects
    assert plain.samples_per_period is None and "frequency" not in plain.document()


def test_a_study_is_the_same_from_its_document(tmp_path: Path) -> None:
    for name in ("paper", "reach", small(tmp_path)):
        study = lw.study.read_study(name)
        again = build_study(json.loads(study.text()), "again", Path())
        assert again.text() == study.text()
        for subject, subject_again in zip(some(study.subjects), again.subjects, strict=True):
            assert subject.structure == subject_again.structure


def test_every_key_reaches_the_subject(tmp_path: Path) -> None:
    lw.write_structure(lw.bnes_chain(4), tmp_path / "chain.toml")
    (tmp_path / "mine.toml").write_text(
        HEAD + '[[structure]]\nname = "mine"\nfile = "chain.toml"\nduration = 0.2\nrate = 1000\nsensors = ["v", "x:m2"]\n'
        'unknown = ["nes1", "spring2.k"]\njudge = ["nes1"]\nscatter = 0.5\nrelease = { "x:m1" = 0.01 }\n'
        'forces = { m2 = "sin(9*t)" }\n[[structure.impulse]]\nmass = "m1"\nmomentum = 0.3\ntime = 0.1\n' + METHOD,
        encoding="utf-8",
    )  # fmt: skip
    study = lw.study.read_study(tmp_path / "mine.toml")
    (subject,) = study.subjects
    unknown = {"spring2.k", "nes1.alpha", "nes1.beta", "nes1.c"}
    assert study.name == "mine" and {p.name for p in subject.unknown_structure.parameters} == unknown
    clean = subject.simulate(cycle=2)
    expected = lw.simulate(
        lw.bnes_chain(4), duration=0.2, rate=1000.0, impulses=[lw.model.Impulse("m1", 0.3, 0.1)],
        release={"x:m1": 0.02}, forces={"m2": "sin(9*t)"},  # twice, by scatter 0.5 and cycle 2
    )  # fmt: skip
    assert (clean.channel("x:m4") == expected.channel("x:m4")).all()
    assert subject.measured(clean).channels == ("v:m1", "v:m2", "v:m3", "v:m4", "x:m2", "force:m2")
    assert subject.judged_links == ("nes1",)


def test_without_a_mistake_it_is_read() -> None:
    assert len(parse_study(GOOD, "s.toml", Path())) == 100
    text = GOOD.replace("rate", 'unknown = ["spring"]\nrate')
    (subject,) = parse_study(text, "s.toml", Path()).subjects
    assert subject.judged_links == ("spring1",)  # none is bent


def test_names_that_are_not_there_and_what_is_no_study(tmp_path: Path) -> None:
    (tmp_path / "bytes.toml").write_bytes(b"\xff\xfe")
    lw.write_structure(lw.bnes_chain(2).unknown("nes"), tmp_path / "unknown.toml")
    (tmp_path / "unknown_study.toml").write_text(GOOD.replace("bnes = 2", 'file = "unknown.toml"'))
    for study, message in (
        ("papr", r'papr: there is no such study; did you mean "paper"\?.*: paper, reach$'),
        (tmp_path, "there is no such study; give"),
        (tmp_path / "bytes.toml", "is not UTF-8 text"),
        (
            tmp_path / "unknown_study.toml",
            r"structure\[0\]\.file: nes1\.alpha is unknown, .* name in `unknown`",
        ),
    ):
        with pytest.raises(lw.StudyError, match=message):
            lw.study.read_study(study)
    given = parse_study(TEXT.format(cycles=1), "small.toml", Path())
    with pytest.raises(lw.StudyError, match=r'unknown structure "bnes3"; did you mean "bnes[24]"'):
        given.subject("bnes3")
    with pytest.raises(lw.StudyError, match='unknown method "mll"; did you mean "ml"'):
        given.method("mll")


def test_the_documented_study_is_one() -> None:
    page = (Path(__file__).parents[2] / "docs" / "how-to" / "studies-and-clusters.md").read_text(
        encoding="utf-8"
    )
    study = parse_study(page.partition("```toml\n")[2].partition("```")[0], "studies-and-clusters.md", Path())
    assert study.first_seed == 1 and study.cycles == 50 and study.quick == 3
    told = ["ml", "physics-informed", "all monomials"]
    assert [method.name for method in study.methods] == [*told, "discover", "sindy, links", "pysindy"]
    assert study.subjects[0].judged_links == ("nes1", "nes2")
    for name in some(re.findall(r"\blw\.([\w.]+)", page)):
        assert attrgetter(name)(lw) is not None


MADE = """
snr_db = [40]
[[structure]]
duration = 1.0
rate = 500.0
unknown = ["joint"]
toml = '''
name = "beam with a slipping joint"
[[host]]
name = "beam"
frequency_sigma = "1 %"
modes = [ { frequency = "5 Hz", damping = 0.01, shape = { tip = 1.0 } } ]
[[mass]]
name = "store"
mass = 0.1
[[link]]
name = "joint"
between = ["store", "beam.tip"]
law = "bouc-wen"
coefficients = { k = 200.0, c = 0.5, F = 2.0, x0 = "5 mm", s = 0.6 }
'''
values = { "joint.F" = 3.0 }
sensors = ["a", "state:joint.z", "f:joint"]
release = { "v:beam.mode1" = 0.5, "state:joint.z" = 0.1 }
forces = { "beam.tip" = "sin(20*t)" }
[[method]]
kind = "ml"
"""


def test_a_study_takes_points_states_and_other_values() -> None:
    (subject,) = (study := parse_study(MADE, "m.toml", Path())).subjects
    clean = subject.simulate()
    seen = subject.measured(clean)
    assert seen.channels == ("a:beam.tip", "a:store", "state:joint.z", "f:joint", "force:beam.tip")
    assert seen.channel("state:joint.z")[0] == 0.1
    assert subject.judged_links == ("joint",)
    assert subject.true_structure.coefficient("joint.F").value == 3.0
    again = build_study(json.loads(study.text()), "again", Path()).subjects[0]
    assert again.structure == subject.structure and again.release == subject.release


def test_what_is_known_to_within_is_told_wrong_by_its_deviation() -> None:
    (subject,) = parse_study(MADE, "m.toml", Path()).subjects
    assert subject.true_structure.coefficient("beam.mode1.frequency").value == 5.0
    told = [subject.stated_structure(seed).coefficient("beam.mode1.frequency") for seed in range(400)]
    assert {coefficient.sigma for coefficient in told} == {0.05} and not any(c.known for c in told)
    values = np.array([coefficient.value for coefficient in told])
    # 400 draws: standard errors of 0.05/20 and 0.05/28; four of them
    assert values.mean() == pytest.approx(5.0, abs=4 * 0.05 / 20)
    assert values.std() == pytest.approx(0.05, rel=4 / 28)
    assert subject.stated_structure(7) == subject.stated_structure(7) != subject.stated_structure(8)
    plain = lw.study.Subject("chain", lw.bnes_chain(2), duration=1.0, rate=500.0)
    assert plain.stated_structure(1) is plain.unknown_structure and plain.true_structure is plain.structure


VARIED = MADE.replace(
    "[[method]]",
    """
[[structure.variant]]
name = "short"
duration = 0.5
[[structure.variant]]
name = "stiff"
values = { "joint.k" = 400.0 }
[[method]]""",
).replace("duration = 1.0", 'name = "beam"\nduration = 1.0')


def test_variants_take_all_but_their_own_keys_from_the_structure() -> None:
    study = parse_study(VARIED, "m.toml", Path())
    plain, short, stiff = study.subjects
    assert [subject.name for subject in study.subjects] == ["beam", "beam, short", "beam, stiff"]
    assert (plain.duration, short.duration, stiff.duration) == (1.0, 0.5, 1.0)
    assert short.structure == plain.structure and short.release == plain.release
    values = [subject.true_structure.link("joint").values for subject in study.subjects]
    assert [(value["k"], value["F"]) for value in values] == [(200.0, 3.0), (200.0, 3.0), (400.0, 3.0)]
    again = build_study(json.loads(study.text()), "again", Path())
    assert again.text() == study.text() and len(again.subjects) == 3


def test_all_unknowns_beside_a_host_are_those_of_links() -> None:
    """Modes without a start could not be identified; they are where they are named."""
    text = MADE.replace('frequency_sigma = "1 %"', "")
    for asked, more in (("", set()), ('unknown = ["joint", "beam.mode1.damping"]', {"beam.mode1.damping"})):
        (subject,) = parse_study(text.replace('unknown = ["joint"]', asked), "m.toml", Path()).subjects
        names = {f"joint.{key}" for key in ("k", "c", "F", "x0", "s")} | more
        assert {p.name for p in subject.unknown_structure.parameters} == names


MISTAKES = [
    ("[20]", "[20", r"s\.toml, line 2, column 1: is not valid TOML: unclosed array"),
    (HEAD, "", r"s\.toml: the key `snr_db` is missing"),
    (STRUCTURE, "", r"s\.toml: the key `structure` is missing"),
    ("[20]", "[]", r"s\.toml, snr_db: a study needs at least one"),
    ("[20]", "[20, 20]", r"s\.toml, snr_db: 20\.0 is listed 2 times"),
    ("[20]", "[nan]", r"s\.toml, snr_db: a signal-to-noise ratio must be a finite number"),
    (HEAD, HEAD + "cycles = 0\n", r"s\.toml, cycles: must be at least 1, got 0"),
    (HEAD, HEAD + "cycels = 3\n", r's\.toml: unknown key "cycels"; did you mean "cycles"\?'),
    (METHOD, STRUCTURE + METHOD, r"s\.toml, structure: 'bnes2' is listed 2 times"),
    ("rate", "raet", r's\.toml, structure\[0\]: unknown key "raet"; did you mean "rate"'),
    ("rate = 500.0", "", r"s\.toml, structure\[0\]: the key `rate` is missing"),
    ("500.0", "0", r"s\.toml, structure\[0\]\.rate: must be positive and finite, got 0"),
    ("500.0", "[50, 50]", r"s\.toml, structure: 'bnes2, 50 Hz' is listed 2 times"),
    ("rate", "frequency = 0\nrate", r"s\.toml, structure\[0\]\.frequency: must be positive and finite, got 0"),
    ("bnes = 2", "bnes = 3", r"s\.toml, structure\[0\]\.bnes: the number of masses must be even and at least 2"),
    ("bnes = 2", 'bnes = 2\nfile = "x"', r"structure\[0\]: .* got bnes and file"),
    ("bnes = 2", 'file = "no.toml"', r"structure\[0\]\.file: no\.toml: there is no such file"),
    ("v:m1", "v:m9", r'structure\[0\]\.release\.v:m9: unknown mass .m9. in a release; the masses are m1, m2'),
    ("v:m1", "a:m1", r"release\.a:m1: unknown release 'a:m1'; expected a displacement, such as x:m1"),
    ("rate", 'sensors = ["z"]\nrate', r"\.sensors: invalid sensor: 'z' is not a channel"),
    ("rate", 'unknown = ["nse"]\nrate', r'structure\[0\]\.unknown: "nse" is not a link'),
    ("rate", 'base = "sin(t)"\nrate', r'structure\[0\]\.base: the motion of the base is given, but no link'),
    ("rate", 'impulse = [{ mass = "m1", kick = 1 }]\nrate', r'impulse\[0\]: unknown key "kick"; the keys'),
    ("weak", "waek", r"method\[0\]\.kind: expected one of ml, .*; got 'waek'; did you mean \"weak\"\?"),
    (METHOD, METHOD + "order = 3\n", r'method\[0\]: unknown key "order"; the keys are name, kind'),
    ("weak", "monomial", r"method\[0\]: the key `convention` is missing, one of displacement, states, diff"),
    ('"weak"', '"monomial"\nconvention = "stats"', r"convention: expected one of disp.*; got 'stats'; .*\"states\"\?"),
    ('"weak"', '"sindy"\nregressor = "lasso"', r"method\[0\]: unknown regressor 'lasso'"),
    ('"weak"', '"monomial"\nconvention = "states"\nregressor = "l1"\nthreshold = 0.1',
     r"s\.toml, method\[0\]: a threshold of 0\.1 was given, and least squares with an L1 penalty has none"),
    ('"weak"', '"discover"\nterms = ""', r"s\.toml, method\[0\]: the list of terms is empty"),
    ('"weak"', '"sindy"\nlibrary = "link"', r"library: .*got 'link'; did you mean \"links\""),
]  # fmt: skip
MISTAKES_OF_HOSTS_AND_VARIANTS = [
    ("v:beam.mode1", "v:beam.tip", r"release\.v:beam\.tip: .* that of a point, .* such as v:beam\.mode1"),
    ("v:beam.mode1", "f:joint", r"release\.f:joint: unknown release 'f:joint'; expected a displacement"),
    ('"state:joint.z" = 0.1', '"state:joint.y" = 0.1', r"unknown state 'joint\.y'.*; the states are joint\.z"),
    ('"state:joint.z", "f', '"state:joint.q", "f', r"sensors: unknown state 'joint\.q'"),
    ('{ "beam.tip"', '{ "beam.tp"', r'forces\.beam\.tp: unknown mass .beam\.tp. in a force; did you mean "beam\.tip"'),
    ('"joint.F" = 3.0', '"joint.G" = 3.0', r'structure\[0\]\.values: unknown coefficient "joint\.G"'),
    ("k = 200.0", 'k = "unknown"', r"joint\.k is unknown, .* a number here or in `values`"),
    ("duration = 0.5", "durattion = 0.5", r'structure\[0\]\.variant\[0\]: unknown key "durattion"; did you mean'),
    ('name = "short"\n', "", r"structure\[0\]\.variant\[0\]\.name: give the variant a name"),
    ('"short"', '"stiff"', r"structure: 'beam, stiff' is listed 2 times"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("text", "old", "new", "message"),
    [
        *((GOOD, *mistake) for mistake in MISTAKES),
        *((VARIED, *mistake) for mistake in MISTAKES_OF_HOSTS_AND_VARIANTS),
    ],
)
def test_a_mistake_is_named_with_its_key(text: str, old: str, new: str, message: str) -> None:
    assert old in text
    with pytest.raises(lw.StudyError, match=message):
        parse_study(text.replace(old, new), "s.toml", Path())
