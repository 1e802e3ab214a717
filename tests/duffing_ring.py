"""The ring of five coupled Duffing oscillators of Hsu et al., arXiv 2511.18555: 150 samples 0.2 s apart, 15.5 dB."""

from dataclasses import replace

import numpy as np
from structures import link, structure

import linkwise as lw

SIZE, RATE, DURATION, NOISE = 5, 5.0, 29.8, 0.2
STIFFNESS = (2.60754067, 3.28886461, 2.18958805, 2.47940855, 2.01218038)  # N/m, of their published notebook
VALUES = np.array(
    [*STIFFNESS, *[2.0] * SIZE, *[-2.0] * SIZE]
)  # springs to the ground, their cubic terms, the ring


def ring(ground: np.ndarray, cubic: np.ndarray, coupling: np.ndarray) -> lw.Structure:
    """Masses of 1 kg on springs with a cubic term, each coupled with the next."""
    springs = (
        link(f"spring{k + 1}", f"m{k + 1}-ground", "k*d + k3*d**3", k=float(ground[k]), k3=float(cubic[k]))
        for k in range(SIZE)
    )
    couplings = (
        link(f"ring{k + 1}", f"m{k + 1}-m{(k + 1) % SIZE + 1}", "k*d", k=float(coupling[k]))
        for k in range(SIZE)
    )
    return structure({f"m{k + 1}": 1.0 for k in range(SIZE)}, *springs, *couplings, name="ring")


def motion(values: np.ndarray, x: np.ndarray, v: np.ndarray) -> lw.Record:
    """The displacements; `values` are the 15 coefficients, of the ground springs, their cubic terms and the ring."""
    release = {f"x:m{k + 1}": float(x[k]) for k in range(SIZE)} | {
        f"v:m{k + 1}": float(v[k]) for k in range(SIZE)
    }
    return lw.simulate(ring(*values.reshape(3, SIZE)), release=release, duration=DURATION, rate=RATE)


def noisy(seed: int) -> lw.Record:
    """The record from rest at 1 m with noise, of which it says nothing."""
    clean = motion(VALUES, np.ones(SIZE), np.zeros(SIZE))
    noise = NOISE * np.random.default_rng(seed).normal(size=clean.values.shape)
    return replace(clean, values=clean.values + noise)
