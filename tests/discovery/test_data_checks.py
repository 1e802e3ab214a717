"""What is said before any time is spent: masses without a sensor, at rest, records too short, motion that is none."""

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record, parsed
from within import masses

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


def test_good_records_need_no_warning(record: lw.Record, chain: lw.Structure) -> None:
    """Any kind of sensor shows a mass, and a record in which masses move makes up for one in which they do not."""
    every = chain_record(4, sensors=("x", "v", "a"))
    mixed = every.with_noise(20.0, seed=1000).select(("x:m1", "v:m2", "a:m3", "x:m4"))
    for good in (record, record[:300], mixed, [quieted(record, m4=0.0), quieted(record)]):
        assert lw.discovery.check_discovery(good, masses(chain)) == ()


def test_a_link_to_a_base_that_was_not_recorded_is_refused(record: lw.Record, chain: lw.Structure) -> None:
    """Without the displacement of the base the equation of its mass does not exist."""
    text = lw.model.format_structure(chain.unknown("all")).replace('"ground"', '"base"')
    based = lw.parse_structure(text)
    name = next(link.name for link in based.links if "base" in link.between)
    for work in (lw.discovery.check_discovery, lw.discover):
        with pytest.raises(lw.IdentificationError, match=f'"{name}" ends at the base, .* channel x:base'):
            work(record, based)


@pytest.mark.parametrize("kind", ["v", "a"])
def test_a_base_without_displacement_is_refused(record: lw.Record, chain: lw.Structure, kind: str) -> None:
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


def test_masses_that_do_not_or_hardly_move_are_named(record: lw.Record, chain: lw.Structure) -> None:
    (remark,) = lw.discovery.check_discovery(quieted(record, m4=0.0), masses(chain))
    assert remark.startswith("m4 did not move above the noise and is left out")
    assert remark.endswith("Excite the structure nearer to it.")
    (two,) = lw.discovery.check_discovery(quieted(record, m2=0.0, m4=0.0), masses(chain))
    assert two.startswith("m2 and m4 did not move above the noise and are left out")
    faint = quieted(record, m2=NOISE / float(np.std(record.channel("x:m2"))))  # 0 dB
    (hardly,) = lw.discovery.check_discovery(faint, masses(chain))
    assert hardly == "m2 hardly moved above the noise: weak terms of links there will be missed."


def test_a_short_record_is_refused_with_the_samples_it_needs(record: lw.Record, chain: lw.Structure) -> None:
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
    half = record[:120]
    assert any("are few" in remark for remark in lw.discovery.check_discovery(half, masses(chain)))
    both = lw.discovery.check_discovery([half, record[120:240]], masses(chain))  # which count together
    assert not any("are few" in remark for remark in both)


@pytest.mark.parametrize(
    ("factor", "said", "faint", "faintly", "loud"),
    [
        (1.0, "together, with differences below the noise", 4.0, "differences down to 6 dB above", None),
        (-0.4, "in proportion, as in one mode, with deviations below the noise", 2.0, "in proportion", 8.0),
    ],
    ids=["alike", "in proportion"],
)
def test_masses_that_move_alike_are_named(
    factor: float,
    said: str,
    faint: float,
    faintly: str,
    loud: float | None,
    clean: lw.Record,
    chain: lw.Structure,
) -> None:
    """A link to the one looks like a link to the other. With a wave of so many times the noise beside, they differ.

    Of 4: 16 / 2 of the power of the noise, and the difference has that of both channels.
    """
    wave = np.sin(150.0 * np.arange(len(clean)) / clean.rate)

    def remarks(size: float) -> tuple[str, ...]:
        values = clean.values.copy()
        values[:, 3] = factor * values[:, 2] + size * NOISE * wave
        return lw.discovery.check_discovery(quieted(replace(clean, values=values)), masses(chain))

    (remark,) = remarks(0.0)
    assert remark.startswith(f"m3 and m4 moved {said}: ") and "Excite" in remark
    (fainter,) = remarks(faint)
    assert faintly in fainter
    assert loud is None or remarks(loud) == ()
    assert lw.discovery.check_discovery(quieted(clean), masses(chain)) == ()
