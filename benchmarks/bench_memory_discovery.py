"""Which of four links has memory: `discover`, told the masses of a chain alone, with one Bouc-Wen link among linear ones.

Displacements of all masses and the force on the second are recorded for 10 s at 400 Hz with noise at 40 dB; the link and the
forces change with the seed. LINKWISE_SEEDS says how many records (default 20). Seeds are others than those of the tests.
"""

from __future__ import annotations

import os
import time

import numpy as np

import linkwise as lw

SEEDS = int(os.environ.get("LINKWISE_SEEDS", "20"))
FIRST = 8000  # of the seeds
SNR = 40.0
MASSES = 4
NUMBER = lw.Coefficient.number
HYSTERETIC = {"k": 1200.0, "c": 1.0, "F": 6.0, "x0": 0.004, "s": 0.6}


def chain(which: int) -> lw.Structure:
    """A chain whose link number `which` is hysteretic."""
    masses = tuple(lw.Mass(f"m{i}", NUMBER(1.0 + 0.1 * i)) for i in range(1, MASSES + 1))
    links = []
    for number, mass in enumerate(masses):
        ends = (mass.name, masses[number - 1].name if number else "ground")
        if number == which:
            values = {name: NUMBER(value) for name, value in HYSTERETIC.items()}
            links.append(lw.model.named_law("bouc-wen").link("-".join(ends), ends, values))
        else:
            values = {"k": NUMBER(2100.0 + 100.0 * number), "c": NUMBER(1.0)}
            links.append(lw.Link("-".join(ends), ends, lw.Law.parse("k*d + c*v"), values))
    return lw.Structure("chain", masses, tuple(links))


def noisy(structure: lw.Structure, seed: int) -> lw.Record:
    """A record under a force of six sines."""
    rng = np.random.default_rng(seed)
    sines = zip(rng.uniform(4, 12, 6), rng.uniform(5, 90, 6), rng.uniform(0, 6, 6), strict=True)
    force = " + ".join(f"{a:.3f}*sin({w:.3f}*t + {p:.3f})" for a, w, p in sines)
    record = lw.simulate(structure, forces={"m2": force}, duration=10.0, rate=400.0, sensors=("x",))
    return record.with_noise(SNR, seed=seed)


def test_link_with_memory_is_found() -> None:
    right = trusted = 0
    wrong, seconds = [], []
    for seed in range(FIRST, FIRST + SEEDS):
        structure = chain(seed % MASSES)
        names = {link.name for link in structure.links}
        true = structure.links[seed % MASSES].name
        began = time.process_time()
        found = lw.discover(
            noisy(structure, seed), {mass.name: mass.mass.value or 0.0 for mass in structure.masses}
        )
        seconds.append(time.process_time() - began)
        links = [law.link for law in found.memory if law.kept]
        is_right = links == [true] and {link.name for link in found.structure.links} == names
        false = [term.name for term in found.kept if term.certain and term.link not in names]
        false += [law.link for law in found.memory if law.certain and law.link != true]
        wrong += [f"{seed}: {name}" for name in false]
        wrong += [f"{seed}: trusted"] if found.trusted and not is_right else []
        right, trusted = right + is_right, trusted + found.trusted
        laws = [f"{law.link} {law.law}" for law in found.memory]
        print(
            f"\n  seed {seed}: {true}, found {laws}, trusted {found.trusted}, {seconds[-1]:.1f} CPU-s", end=""
        )
    print(
        f"\n  right {right} of {SEEDS}, trusted {trusted}, wrong and certain or trusted {wrong}; CPU-s median "
        f"{np.median(seconds):.1f}, worst {max(seconds):.1f}"
    )
    assert right >= 0.9 * SEEDS and not wrong
