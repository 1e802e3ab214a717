"""Bands of response curves: is the true curve inside them, at each frequency and over all records?

LINKWISE_SEEDS says how many records (default 10; 100 are asked). Asked: 88 to 99 % of the records at each frequency, 92 to
98 % of all together.
"""

from __future__ import annotations

import os
from itertools import pairwise
from time import process_time

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import linkwise as lw

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "10"))
FIRST_SEED = 8_000_000  # of no test
DRIVEN = {"force": {"m1": 1.0}, "levels": (1.0, 4.0), "hz": (3.0, 9.0), "starts": 0}
GRID = np.linspace(3.2, 8.8, 29)
TRUE = lw.rig(
    masses={"m1": 1.0, "m2": 0.3},
    links={"leaf": "m1 - ground: k*d + k3*d**3 + c*v", "joint": "m2 - m1: k*d + k3*d**3 + c*v"},
    known={
        "leaf.k": 900.0, "leaf.k3": 4e4, "leaf.c": 1.5, "joint.k": 400.0, "joint.k3": 8e4, "joint.c": 0.5,
    },
)  # fmt: skip
SWEEP = "8*sin(2*pi*(2 + 0.8*t)*t)"


def stable_parts(response: lw.response.Response, level: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Amplitudes, and their bands, at the frequencies of the grid: one for each stretch of stable motion, NaN beyond it."""
    parts = []
    for branch in response.levels[level].branches:
        columns = (
            [branch.amplitude] if branch.lower is None else [branch.amplitude, branch.lower, branch.upper]
        )
        table = np.stack(columns, axis=1)
        forward = np.sign(np.diff(branch.hz))
        stable = branch.stable & np.isfinite(table).all(axis=(1, 2))
        turns = np.flatnonzero((np.diff(forward) != 0.0) | ~stable[1:-1]) + 1
        for first, last in pairwise([0, *turns.tolist(), len(branch.hz) - 1]):
            rows = np.arange(first, last + 1)
            rows = rows[stable[rows]]
            if len(rows) > 2:
                rows = rows[np.argsort(branch.hz[rows])]
                flat = table[rows].reshape(len(rows), -1)
                # by cubics: straight lines are off by as much as a band is wide where nothing moves a curve
                values = CubicSpline(branch.hz[rows], np.log(flat), extrapolate=False)(GRID)
                parts.append(np.exp(values).reshape(len(GRID), *table.shape[1:]))
    return parts


def covered(answer: lw.response.Response, truth: lw.response.Response, level: int) -> np.ndarray:
    """(frequencies, channels): 1 inside the band, 0 outside, NaN where there is none."""
    inside = np.full((len(GRID), len(answer.channels)), np.nan)
    true = [part[:, 0] for part in stable_parts(truth, level)]
    for part in stable_parts(answer, level):
        apart = np.array([np.abs(np.log(one / part[:, 0])) for one in true])
        for f, c in np.argwhere(np.isfinite(part).all(axis=1) & np.isfinite(apart).any(axis=0)):
            one = true[int(np.nanargmin(apart[:, f, c]))][f, c]
            inside[f, c] = part[f, 1, c] <= one <= part[f, 2, c]
    return inside


def test_the_true_curve_is_inside_the_band() -> None:
    truth = lw.respond(TRUE, **DRIVEN)
    clean = lw.simulate(TRUE, forces={"m1": SWEEP}, duration=5.0, rate=200.0)
    inside, seconds = [], []
    for seed in range(FIRST_SEED, FIRST_SEED + SEEDS):
        fit = lw.identify(clean.with_noise(30.0, seed=seed), TRUE.unknown("all"))
        assert fit.intervals
        started = process_time()
        answer = lw.respond(fit, **DRIVEN)
        seconds.append(process_time() - started)
        inside.append([covered(answer, truth, level) for level in range(2)])
        print(f"  {seed}: {100 * np.nanmean(inside[-1]):.0f} %, {seconds[-1]:.1f} s", flush=True)
    table = np.array(inside)  # (records, levels, frequencies, channels)
    at_each = np.nanmean(table, axis=0)
    print(
        f"\n{SEEDS} records of two masses, 5 s at 30 dB: {np.median(seconds):.1f} s for curves with bands of 100 draws"
    )
    print(f"  the true curve is inside at {100 * np.nanmean(table):.1f} % of all frequencies")
    for level, each in zip(DRIVEN["levels"], at_each, strict=True):
        low, high = 100 * np.nanmin(each), 100 * np.nanmax(each)
        print(f"  {level:g} N: {low:.0f} to {high:.0f} % of the records at each frequency")
    if SEEDS < 100:
        pytest.skip(f"{SEEDS} seeds measure; 100 judge")
    assert 0.92 <= np.nanmean(table) <= 0.98
    assert np.nanmin(at_each) >= 0.88
