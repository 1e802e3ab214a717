"""Faults that are marked as missing, and spectra over gaps."""

from dataclasses import replace

import numpy as np
import pytest
from problems import chain_record, truth
from record_faults import chain, changed, faulty, forced

import linkwise as lw

PEAK = 0.8  # of the largest motion, at which a sensor is overloaded
SPIKES = (400, 1200, 2900)


def overloaded(record: lw.Record) -> tuple[lw.Record, np.ndarray]:
    """The record with every channel clipped, and which samples (N, C) are."""
    peak = PEAK * np.max(np.abs(record.values), axis=0)
    clipped = replace(record, values=np.clip(record.values, -peak, peak), simulated=None)
    return clipped, np.abs(record.values) >= peak


def test_clipped_samples_are_marked_and_those_that_noise_alone_held_inside() -> None:
    """A sample whose motion is 6 deviations inside of the range is never marked, by normal noise."""
    exact, whole = chain_record(2), chain(2, 30.0)
    record, clipped = overloaded(whole)
    marked = lw.inspection.mark_missing(record, "clipped")
    missing = np.isnan(marked.values)
    assert clipped.any(axis=0).all() and missing[clipped].all()
    np.testing.assert_array_equal(marked.values[~missing], record.values[~missing])
    deviation = np.std(whole.values - exact.values, axis=0)
    inside = PEAK * np.max(np.abs(whole.values), axis=0) - np.abs(exact.values)
    assert (inside < 6.0 * deviation)[missing].all()
    assert marked.notes[len(record.notes) :] == tuple(
        f"{name}: {count} samples were marked as missing (clipped)."
        for name, count in zip(record.channels, missing.sum(axis=0), strict=True)
    )
    assert "clipped" not in {alert.kind for alert in lw.inspect(marked).alerts}


def test_spikes_are_marked_and_no_others() -> None:
    def spiked(values: np.ndarray, record: lw.Record, rng: np.random.Generator) -> np.ndarray:
        values[list(SPIKES)] += 3.0 * np.std(values)
        return values

    marked = lw.inspection.mark_missing(faulty(chain(2, 30.0), "x:m1", spiked))
    assert np.flatnonzero(np.isnan(marked.channel("x:m1"))).tolist() == list(SPIKES)
    assert not np.isnan(marked.channel("x:m2")).any()


def test_inputs_and_clean_records_stay_as_they_are() -> None:
    record = forced(40.0)
    limited = np.clip(record.channel("force:m1"), -3.0, 3.0)  # of a force of 6 N
    marked = lw.inspection.mark_missing(changed(record, force_m1=limited))
    np.testing.assert_array_equal(marked.channel("force:m1"), limited)
    record = chain(2, 30.0)
    assert lw.inspection.mark_missing(record) is record
    with pytest.raises(lw.RecordError, match=r"unknown fault of samples 'cliped'.*'clipped'"):
        lw.inspection.mark_missing(record, "cliped")


@pytest.mark.parametrize("snr_db", [20.0, 40.0])
def test_errors_are_those_of_the_record_without_clipping(snr_db: float) -> None:
    """Standard errors grow by less than 1.5; the truth is within 4.5 of them, but once in 30 000 a coefficient."""
    whole = chain_record(2).with_noise(snr_db, seed=21)
    chain_of_two = lw.bnes_chain(2)
    records = whole, lw.inspection.mark_missing(overloaded(whole)[0])
    fits = [lw.identify(record, chain_of_two.unknown("all")) for record in records]
    before, after = (np.sqrt(fit.covariance.diagonal()) for fit in fits)
    true = truth(chain_of_two, fits[1].given_structure)
    assert fits[1].trusted
    assert (after < 1.5 * before).all()
    assert (np.abs(fits[1].values - true) < 4.5 * after).all()


def _recovering(seed: int) -> tuple[lw.Record, slice]:
    """A record of a chain of which x:m2 stays at the end of its range for 0.9 s from its first overload on, and where."""
    record = chain_record(2).with_noise(35.0, seed=seed)
    values = record.values.copy()
    column = record.channels.index("x:m2")
    peak = PEAK * float(np.abs(values[:, column]).max())
    values[:, column] = np.clip(values[:, column], -peak, peak)
    first = int(np.argmax(np.abs(values[:, column]) >= peak))
    stay = slice(first, first + round(0.9 * record.rate))
    values[stay, column] = values[first, column]
    return replace(record, values=values, simulated=None), stay


@pytest.mark.slow
def test_readings_of_a_sensor_that_recovers_are_missing_and_no_bounds() -> None:
    record, stay = _recovering(5215601)
    marked = lw.inspection.mark_missing(record, "clipped")
    assert np.isnan(marked.channel("x:m2")[stay]).all()
    bounds = marked.clipped.get("x:m2")
    assert bounds is None or np.isnan(bounds.readings[stay]).all()
    (note,) = (note for note in marked.notes if "longer than two of its periods" in note)
    assert note.startswith(f"x:m2: its readings at the end of the range from {record.time[stay.start]:.6g} s")
    chain = lw.bnes_chain(2)
    asked = chain.unknown("nes")
    fit = lw.identify(marked, asked)
    assert fit.trusted and not any("taken as missing" in remark for remark in fit.remarks)
    # four standard errors: 6e-5 of chance each
    assert np.all(np.abs(fit.values - truth(chain, asked)) < 4.0 * np.sqrt(fit.covariance.diagonal()))
