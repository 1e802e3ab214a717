"""What is said before any time is spent: masses without a sensor, at rest, records too short, motion that is none."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from judged import masses
from problems import chain_record, parsed
from structures import link, structure

import linkwise as lw

NOISE = 1e-4  # m


@pytest.fixture(scope="module")
def chain() -> lw.Structure:
    return lw.bnes_chain(4)


@pytest.fixture(scope="module")
def clean() -> lw.Record:
    """Displacements of all four masses, six seconds at 1 kHz."""
    return chain_record(4)


@pytest.fixture(scope="module")
def record(clean: lw.Record) -> lw.Record:
    return clean.with_noise(20.0, seed=1000)


def quieted(record: lw.Record, **share: float) -> lw.Record:
    """The motion of some masses scaled down, white noise of `NOISE` on all."""
    factors = np.array([share.get(channel.removeprefix("x:"), 1.0) for channel in record.channels])
    noise = NOISE * np.random.default_rng(1000).normal(size=record.values.shape)
    stated: dict[str, float] = dict.fromkeys(record.channels, NOISE)
    return replace(record, values=record.values * factors + noise, noise=stated, simulated=None)


def test_a_good_record_needs_no_warning(record: lw.Record, chain: lw.Structure) -> None:
    assert lw.discovery.check_discovery(record, masses(chain)) == ()


def test_a_mass_without_a_sensor_is_refused_by_name(record: lw.Record, chain: lw.Structure) -> None:
    selected = record.select(("x:m1", "x:m3"))
    with pytest.raises(
        lw.IdentificationError,
        match=r"no channel measures the motion of m2 and m4, .*; add a channel x:m2, or identify",
    ):
        lw.discovery.check_discovery(selected, masses(chain))
    with pytest.raises(lw.IdentificationError, match="no channel measures the motion of m2 and m4"):
        lw.discover(selected, masses(chain))
    with pytest.raises(lw.IdentificationError, match="no channel measures the motion of m2, and links"):
        lw.discovery.check_discovery(
            [record[:-1], record[1:].select(("x:m1", "x:m3", "x:m4"))], masses(chain)
        )  # in one of two records


def test_any_kind_of_sensor_shows_a_mass(chain: lw.Structure) -> None:
    every = chain_record(4, sensors=("x", "v", "a"))
    mixed = every.with_noise(20.0, seed=1000).select(("x:m1", "v:m2", "a:m3", "x:m4"))
    assert lw.discovery.check_discovery(mixed, masses(chain)) == ()


def test_a_stated_link_to_a_base_that_was_not_recorded_is_refused(
    record: lw.Record, chain: lw.Structure
) -> None:
    """Without the displacement of the base the equation of its mass does not exist."""
    text = lw.model.format_structure(chain.unknown("all")).replace('"ground"', '"base"')
    based = lw.parse_structure(text)
    name = next(link.name for link in based.links if "base" in link.between)
    for work in (lw.discovery.check_discovery, lw.discover):
        with pytest.raises(lw.IdentificationError, match=f'"{name}" ends at the base, .* channel x:base'):
            work(record, based)


@pytest.mark.parametrize("kind", ["v", "a"])
def test_a_base_whose_displacement_is_not_there_is_refused(
    record: lw.Record, chain: lw.Structure, kind: str
) -> None:
    """It would be left out without a word, and its links found elsewhere."""
    moved = np.column_stack([record.values, np.sin(150.0 * np.arange(len(record)) / record.rate)])
    based = replace(record, channels=parsed(*record.channels, "x:base"), values=moved, simulated=None)
    assert lw.discovery.check_discovery(based, masses(chain)) == ()
    lost = replace(based, channels=parsed(*record.channels, f"{kind}:base"))
    with pytest.raises(
        lw.IdentificationError, match=f"{kind}:base gives the displacement .* only up to drift"
    ):
        lw.discovery.check_discovery(lost, masses(chain))


def test_motion_that_is_none_is_refused(record: lw.Record, chain: lw.Structure) -> None:
    still = quieted(record, m1=0.0, m2=0.0, m3=0.0, m4=0.0)
    with pytest.raises(
        lw.IdentificationError, match="no motion above the noise in any channel, so no structure"
    ):
        lw.discovery.check_discovery(still, masses(chain))
    offset = replace(still, values=still.values + 0.1)  # a sensor's offset is no motion
    with pytest.raises(lw.IdentificationError, match="no motion above the noise in any channel"):
        lw.discovery.check_discovery(offset, masses(chain))


def test_motion_that_looks_like_noise_is_refused_with_the_way_out() -> None:
    """Of three samples in a period, of which a stated noise tells that they are motion."""
    sparse = lw.simulate(lw.bnes_chain(2), duration=0.6, rate=82.5, release={"v:m1": 1.0})
    with pytest.raises(lw.IdentificationError, match=r"about three samples a period .* state the noise"):
        lw.discovery.check_discovery(sparse, masses(lw.bnes_chain(2)))
    stated = replace(sparse, noise=dict.fromkeys(sparse.channels, 1e-05))
    assert not any(
        "above the noise" in remark
        for remark in lw.discovery.check_discovery(stated, masses(lw.bnes_chain(2)))
    )


def test_masses_at_rest_are_named(record: lw.Record, chain: lw.Structure) -> None:
    (remark,) = lw.discovery.check_discovery(quieted(record, m4=0.0), masses(chain))
    assert remark.startswith("m4 did not move above the noise and is left out") and remark.endswith(
        "Excite the structure nearer to it."
    )
    (two,) = lw.discovery.check_discovery(quieted(record, m2=0.0, m4=0.0), masses(chain))
    assert two.startswith("m2 and m4 did not move above the noise and are left out") and two.endswith(
        "nearer to them."
    )
    # another record in which they move makes up for it
    assert lw.discovery.check_discovery([quieted(record, m4=0.0), quieted(record)], masses(chain)) == ()


def test_masses_that_hardly_move_are_named(record: lw.Record, chain: lw.Structure) -> None:
    rms = float(np.std(record.channel("x:m2")))
    faint = quieted(record, m2=NOISE / rms)  # 0 dB
    assert lw.discovery.check_discovery(faint, masses(chain)) == (
        "m2 hardly moved above the noise: weak terms of links there will be missed.",
    )


def test_a_record_that_is_too_short_is_refused_with_the_samples_that_it_needs(
    record: lw.Record, chain: lw.Structure
) -> None:
    """40 candidates, four samples each over four masses: 40 samples are the least."""
    with pytest.raises(
        lw.IdentificationError, match=r"156 samples over 4 masses for 40 candidates.*record 40 samples"
    ):
        lw.discovery.check_discovery(record[:39], masses(chain))
    remarks = lw.discovery.check_discovery(record[:40], masses(chain))
    assert (
        remarks[-1] == "160 samples for 40 candidates are few: weak terms will be missed; record for longer."
    )
    fewer = lw.discovery.check_discovery(record[:39], masses(chain), terms="linear")  # or allow fewer terms
    assert len(fewer) >= 1
    assert lw.discovery.check_discovery(record[:300], masses(chain)) == ()


def test_two_short_records_count_together(record: lw.Record, chain: lw.Structure) -> None:
    half = record[:120]
    assert any("are few" in remark for remark in lw.discovery.check_discovery(half, masses(chain)))
    assert not any(
        "are few" in remark for remark in lw.discovery.check_discovery([half, record[120:240]], masses(chain))
    )


def test_masses_that_move_alike_are_named(clean: lw.Record, chain: lw.Structure) -> None:
    """A mass that copies another: a link to the one looks like a link to the other."""
    assert lw.discovery.check_discovery(quieted(clean), masses(chain)) == ()
    values = clean.values.copy()
    values[:, 3] = values[:, 2]
    (remark,) = lw.discovery.check_discovery(quieted(replace(clean, values=values)), masses(chain))
    assert remark == (
        "m3 and m4 moved together, with differences below the noise: a link to one of them may be found as a link to another. "
        "Excite them one at a time."
    )
    wave = np.sin(150.0 * np.arange(len(clean)) / clean.rate)
    values[:, 3] += (
        4.0 * NOISE * wave
    )  # 16 / 2 of the power of the noise, and the difference has that of both channels
    (remark,) = lw.discovery.check_discovery(quieted(replace(clean, values=values)), masses(chain))
    assert "m3 and m4 moved together, with differences down to 6 dB above the noise: " in remark


def test_masses_that_move_in_proportion_are_named(clean: lw.Record, chain: lw.Structure) -> None:
    """A mass that copies two fifths of another's motion."""
    values = clean.values.copy()
    values[:, 3] = -0.4 * values[:, 2]
    (remark,) = lw.discovery.check_discovery(quieted(replace(clean, values=values)), masses(chain))
    assert remark == (
        "m3 and m4 moved in proportion, as in one mode, with deviations below the noise: other links may explain such motions "
        "as well. Excite more than one mode."
    )
    wave = np.sin(150.0 * np.arange(len(clean)) / clean.rate)
    for size, count in ((2.0, 1), (8.0, 0)):  # 2 and 32 times the power of the noise of m4
        values[:, 3] = -0.4 * values[:, 2] + size * NOISE * wave
        remarks = lw.discovery.check_discovery(quieted(replace(clean, values=values)), masses(chain))
        assert len(remarks) == count


def test_one_mode_decides_nothing_of_its_masses() -> None:
    """A light mass that follows a heavy one: as an oscillator of its own, in step with it, it explains the record as well."""
    pair = structure(
        {"m1": 0.3, "m2": 3.3},
        link("m1-ground", "m1-ground", "k*d + c*v", k=4e4, c=4.0),
        link("m2-m1", "m2-m1", "k*d + c*v", k=8e3, c=1.0),
        link("m2-ground", "m2-ground", "k*d + c*v", k=1.3e4, c=4.0),
    )
    clean = lw.simulate(pair, release={"x:m2": 0.05, "x:m1": 0.0084}, duration=2.0, rate=400.0)
    discovery = lw.discover(clean.with_noise(12.0, seed=49001), masses(pair))
    assert "m1 and m2 moved in proportion" in discovery.remarks[0]
    assert not [term.name for term in discovery.terms if term.certain]


def test_what_was_foreseen_stands_with_the_answer(chain: lw.Structure) -> None:
    two = lw.bnes_chain(2)
    record = chain_record(2).with_noise(5.0, seed=1000)
    remarks = lw.discovery.check_discovery(record, masses(two))
    assert remarks
    assert set(remarks) <= set(lw.discover(record, masses(two)).remarks)
