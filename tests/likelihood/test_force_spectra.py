"""Ambient forces that are not white, or not independent of each other, where the answer takes them for both."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import scipy
from shaken_chain import NOISE, RATE, STEADY, SUBSTEPS, chain, motion

import linkwise as lw
from linkwise.arrays import Floats
from linkwise.verdict import Verdict


def shown(forces: Floats, rng: np.random.Generator) -> lw.Record:
    """Displacements of two masses, whose modes are at 3 and 8 Hz, in forces from the time on where they are steady."""
    x = motion(forces)[STEADY:, :2]
    return lw.Record(0.0, RATE, ("x:m1", "x:m2"), x + NOISE * rng.standard_normal(x.shape))


def white(rng: np.random.Generator, seconds: float) -> Floats:
    forces: Floats = np.sqrt(SUBSTEPS) * rng.standard_normal(((STEADY + int(seconds * RATE)) * SUBSTEPS, 2))
    return forces


def low_pass(forces: Floats, corner: float) -> Floats:
    """Forces behind a filter of first order at a corner in Hz."""
    b, a = scipy.signal.butter(1, corner / (RATE * SUBSTEPS / 2.0))
    filtered: Floats = scipy.signal.lfilter(b, a, forces, axis=0)
    return filtered


@cache
def in_coloured_forces(corner: float, seconds: float, seed: int) -> lw.Record:
    rng = np.random.default_rng(seed)
    return shown(low_pass(white(rng, seconds), corner), rng)


def test_forces_that_fall_off_in_the_band_of_the_motion_are_named() -> None:
    fit = lw.identify(in_coloured_forces(3.0, 20.0, seed=5700011), chain(2).unknown("all"), ambient="all")
    assert not fit.trusted
    assert fit.verdicts[0] is Verdict.MEASUREMENT_ERROR
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.unit) == ("coloured force", "1")
    assert cause.where in ("m1", "m2")
    assert f"an ambient force on {cause.where} that is not white (its density is" in fit.message
    assert "so none is given: record the forces, or the structure where" in fit.message


def test_forces_that_fall_off_beyond_the_motion_are_as_good_as_white() -> None:
    fit = lw.identify(in_coloured_forces(40.0, 20.0, seed=5700012), chain(2).unknown("all"), ambient="all")
    assert fit.trusted
    assert fit.diagnosis == ()
    assert "which is tested where the structure moves" in fit.message


def test_forces_that_depend_on_each_other_are_named() -> None:
    rng = np.random.default_rng(5700013)
    forces = white(rng, 20.0)
    forces[:, 1] = -0.8 * forces[:, 0] + 0.6 * forces[:, 1]
    fit = lw.identify(shown(forces, rng), chain(2).unknown("all"), ambient="all")
    assert not fit.trusted
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.where, cause.source) == ("correlated forces", "m1", "m2")
    # forces are told with the noise of sensors, which lowers a correlation, here by less than a quarter
    assert cause.size == pytest.approx(-0.8, abs=0.2)
    assert f"a correlation of {cause.size:.2g} between the ambient forces on m1 and m2" in fit.message


def test_records_are_judged_together() -> None:
    """Records of different lengths: white forces are trusted, coloured ones named."""
    rng = np.random.default_rng(5700014)
    records = [shown(white(rng, seconds), rng) for seconds in (12.0, 8.0)]
    fit = lw.identify(records, chain(2).unknown("all"), ambient="all")
    assert fit.trusted, fit.message
    assert fit.diagnosis == ()
    records = [in_coloured_forces(3.0, seconds, seed=5700015) for seconds in (12.0, 8.0)]
    fit = lw.identify(records, chain(2).unknown("all"), ambient="all")
    assert fit.diagnosis[0].kind == "coloured force"


def test_a_record_too_short_for_a_spectrum_is_not_judged() -> None:
    fit = lw.identify(in_coloured_forces(3.0, 1.5, seed=5700016), chain(2).unknown("all"), ambient="all")
    assert not {"coloured force", "correlated forces"} & {cause.kind for cause in fit.diagnosis}


def test_a_level_that_changes_with_time_is_named_before_a_term_that_seems_to_be_missing() -> None:
    rng = np.random.default_rng(5799011)
    forces = white(rng, 40.0)
    second = np.arange(len(forces)) / (RATE * SUBSTEPS)
    forces *= np.where(second % 10.0 < 2.0, 4.0, 1.0)[:, None]
    fit = lw.identify(shown(forces, rng), chain(2).unknown("all"), ambient="all")
    assert fit.verdicts[0] is Verdict.MEASUREMENT_ERROR
    cause = fit.diagnosis[0]
    assert (cause.kind, cause.unit) == ("unsteady force", "1")
    assert f"an ambient force on {cause.where} whose level changes with time (its density is" in fit.message
    assert "times too narrow, and none is given: use parts of the record" in fit.message
