"""Coefficients that change at one moment of a record: how often that is told, and what is trusted though it is wrong.

LINKWISE_SEEDS says how many records of each change (default 12), LINKWISE_FIRST_SEED the first of their seeds.
"""

from __future__ import annotations

import os

import numpy as np
import pytest

import linkwise as lw

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "12"))
FIRST_SEED = int(os.environ.get("LINKWISE_FIRST_SEED", "7100000"))  # of no test
SENSORS = ("x:m1", "x:m2", "v:m1", "v:m2")
DURATION, RATE, SNR = 6.0, 1000.0, 30.0
CHANGES = (0.0, 0.005, 0.01, 0.02, 0.05)
WRONG = 4.0
"""Standard errors: a trusted coefficient farther than that from one of the values that it had is wrong."""


def changing_record(
    chain: lw.Structure, name: str, change: float, seed: int
) -> tuple[lw.Record, lw.Structure]:
    """Two masses, released with a random speed, one coefficient of which changes by a part of itself at a random moment.

    Also the structure behind it.
    """
    random = np.random.default_rng(seed)
    value = chain.coefficient(name).value or 0.0
    after = chain.with_values({name: (1.0 + change * random.choice([-1.0, 1.0])) * value})
    moment = round(random.uniform(0.2, 0.8) * DURATION * RATE) / RATE
    speed = {"v:m1": random.uniform(0.6, 1.4)}
    first = lw.simulate(chain, release=speed, duration=moment, rate=RATE, sensors=SENSORS)
    state = dict(zip(SENSORS, first.values[-1].tolist(), strict=True))
    second = lw.simulate(after, release=state, duration=DURATION - moment, rate=RATE, sensors=SENSORS)
    values = np.concatenate([first.values[:-1, :2], second.values[:, :2]])
    return lw.Record(0.0, RATE, SENSORS[:2], values).with_noise(SNR, seed=seed), after


@pytest.mark.parametrize("name", ["nes1.alpha", "nes1.beta", "spring1.k"])
def test_changes_are_told(name: str) -> None:
    chain = lw.bnes_chain(2)
    asked = chain.unknown("all")
    print(f"\n{name}: {SEEDS} records of {DURATION:g} s at {SNR:g} dB")
    for change in CHANGES:
        named, trusted, errors = 0, 0, []
        for seed in range(FIRST_SEED, FIRST_SEED + SEEDS):
            record, after = changing_record(chain, name, change, seed)
            fit = lw.identify(record, asked)
            named += fit.verdicts[0] is lw.Verdict.COEFFICIENT_CHANGES
            if not fit.trusted:
                continue
            trusted += 1
            values = [[of.coefficient(p.name).value for p in asked.parameters] for of in (chain, after)]
            away = np.abs(fit.values - np.array(values, dtype=float)) / np.sqrt(fit.covariance.diagonal())
            errors.append(float(np.max(away)))
        wrong = sum(error > WRONG for error in errors)
        print(
            f"  by {100.0 * change:g} %: told {named}, trusted {trusted}, of them wrong {wrong}, largest error "
            f"{max(errors, default=0.0):.1f}"
        )
        assert change > 0.0 or (named == 0 and trusted == SEEDS)
