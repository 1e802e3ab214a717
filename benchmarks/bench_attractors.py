"""Attractors of a bistable sink: random simulations end on a branch, or where `respond` tells of irregular motion.

20 frequencies at 4 levels; LINKWISE_SEEDS says how many simulations start at each of these 80 places (default 3, which makes
240; 200 are asked). A simulation that does not repeat must have an irregular motion at one of the frequencies nearest to it
at which `respond` looked.
"""

from __future__ import annotations

import os
from time import process_time

import numpy as np

import linkwise as lw

SEED, PER_PLACE = 9_000_000, int(os.environ.get("LINKWISE_SEEDS", "3"))  # a seed of no test
LEVELS, HZ = (0.3, 1.0, 3.0, 6.0), np.linspace(20.4, 35.6, 20)
CHAIN = lw.bnes_chain(2)
SETTLING, SAMPLES, TURNS = 800, 64, 24  # turns that are left out, samples in a turn, turns that are looked at
SAME = 0.02  # of an amplitude: what has decayed so far, and how far points of a branch are from the line between them
LOOKS = 1.3  # Hz: between the frequencies at which `respond` starts


def settled(level: float, hz: float, rng: np.random.Generator) -> tuple[int, np.ndarray]:
    """Turns after which a simulation from a random state repeats, 0 if it does not, and half of peak to peak (2,)."""
    size = 10.0 ** rng.uniform(-3.0, -1.3)
    states = size * rng.standard_normal(2), 2 * np.pi * hz * size * rng.standard_normal(2)
    release = {
        f"{kind}:m{n + 1}": float(values[n])
        for kind, values in zip("xv", states, strict=True)
        for n in range(2)
    }
    force = {"m1": f"{level!r}*cos({2 * np.pi * hz!r}*t)"}
    run = lw.simulate(
        CHAIN, forces=force, release=release, duration=(SETTLING + TURNS) / hz, rate=SAMPLES * hz
    )
    late = run.values[-SAMPLES * TURNS :, :2].reshape(TURNS, SAMPLES, 2)
    sizes = 0.5 * np.ptp(late.reshape(-1, 2), axis=0)
    for turns in (1, 2, 3, 4):
        if (np.abs(late[turns:] - late[:-turns]).max(axis=(0, 1)) < SAME * sizes).all():
            return turns, sizes
    return 0, sizes


def on_a_branch(level: lw.response.ResponseLevel, hz: float, sizes: np.ndarray) -> bool:
    """Whether a stable branch has these amplitudes at this frequency."""
    for branch in level.branches:
        for k in range(len(branch.hz) - 1):
            ends = np.sort(branch.hz[k : k + 2])
            if ends[0] <= hz <= ends[1] and branch.stable[k : k + 2].any():
                change = branch.hz[k + 1] - branch.hz[k]
                part = (hz - branch.hz[k]) / change if change else 0.0
                here = (1.0 - part) * branch.amplitude[k] + part * branch.amplitude[k + 1]
                if (np.abs(sizes / here - 1.0) < SAME).all():
                    return True
    return False


def test_random_simulations_end_on_branches_or_where_motion_is_irregular() -> None:
    started = process_time()
    response = lw.respond(CHAIN, force={"m1": 1.0}, levels=LEVELS, hz=(20.0, 36.0))
    seconds = process_time() - started
    rng, counts, strays = np.random.default_rng(SEED), dict.fromkeys(("branch", "irregular"), 0), []
    for level in response.levels:
        told = np.array([motion.hz for motion in level.irregular])
        for hz in HZ:
            for _ in range(PER_PLACE):
                turns, sizes = settled(level.size, float(hz), rng)
                if turns and on_a_branch(level, float(hz), sizes):
                    counts["branch"] += 1
                elif (np.abs(told - hz) < LOOKS).any():
                    counts["irregular"] += 1
                else:
                    strays.append((level.size, round(float(hz), 2), turns, sizes.round(5).tolist()))
    print(
        f"\nrespond took {seconds:.1f} s; {len(HZ)} frequencies, {len(LEVELS)} levels, {PER_PLACE} simulations at each"
    )
    print(
        f"  on a stable branch {counts['branch']}, irregular and told {counts['irregular']}, neither {len(strays)}"
    )
    for stray in strays:
        print("  neither: {} N, {} Hz, turns {}, amplitudes {}".format(*stray))
    assert not strays
