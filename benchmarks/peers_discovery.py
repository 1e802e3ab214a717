"""What PySINDy finds in the record that `discover` gets, with a threshold that only the truth could choose.

Displacements alone: velocities are smoothed differences, as its users make them. Every mass then has an equation of its own,
with all monomials of all states up to the third degree, and a link shows as monomials in two of them.
"""

from __future__ import annotations

import resource
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement
from time import perf_counter

import numpy as np
import pysindy
from within import masses

import linkwise as lw

DEGREE = 3
SHARES = 10.0 ** np.arange(-2.5, 0.01, 0.5)  # of the right-hand side: thresholds of normalised columns
SMOOTHING = {"window_length": 15, "polyorder": 4}  # samples at 1 kHz: a fifth of the fastest period
HALF_WINDOW = 0.03  # s, of the test functions


@dataclass(frozen=True)
class Peer:
    """Monomials in the accelerations of all masses: `right`, `missing` and `extra`; s, and MB of the whole process at most."""

    right: int
    missing: int
    extra: int
    seconds: float
    megabytes: float

    @classmethod
    def of(cls, support: np.ndarray, truth: np.ndarray, seconds: float) -> Peer:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return cls(
            int((support & truth).sum()),
            int((truth & ~support).sum()),
            int((support & ~truth).sum()),
            seconds,
            peak / 1024.0,
        )

    def __str__(self) -> str:
        counts = f"{self.right:>4} right {self.missing:>4} missing {self.extra:>5} extra"
        return f"{counts}   {self.seconds:7.2f} s {self.megabytes:7.0f} MB"


def chain_record(n: int, decibel: float, seed: int) -> lw.Record:
    """The paper's chain after its hit, displacements for six seconds at 1 kHz."""
    release = {"v:m1": 1.0 if n == 2 else 3.0}
    return lw.simulate(lw.bnes_chain(n), release=release, duration=6.0, rate=1000.0).with_noise(
        decibel, seed=seed
    )


def monomials(structure: lw.Structure) -> np.ndarray:
    """(n, columns) which monomials of x and v the accelerations consist of, by least squares on states drawn at random."""
    n, random = structure.size, np.random.default_rng(0)
    powers = list(_powers(2 * n))
    states = random.uniform(-1.0, 1.0, size=(2 * len(powers), 2 * n))
    columns = np.stack([np.prod(states[:, list(each)], axis=1) for each in powers], axis=1)
    d, v = structure.elongations(states[:, :n]), structure.elongations(states[:, n:])
    force = np.stack([link.force(d[:, k], v[:, k]) for k, link in enumerate(structure.links)], axis=1)
    push = -force @ structure.incidence.toarray().T
    found, *_ = np.linalg.lstsq(columns, push)
    return np.asarray(np.abs(found.T) > 1e-9 * np.abs(push).max())


def _powers(states: int) -> Iterator[tuple[int, ...]]:
    """In the order of PySINDy's library: by degree, then as scikit-learn counts."""
    for degree in range(1, DEGREE + 1):
        yield from combinations_with_replacement(range(states), degree)


def by_linkwise(n: int, decibel: float, seed: int) -> Peer:
    """`discover`, its links written out as monomials."""
    record, chain = chain_record(n, decibel, seed), lw.bnes_chain(n)
    lw.discover(
        chain_record(2, 40.0, 0)[:500], masses(lw.bnes_chain(2))
    )  # loads and starts what a first search does
    started = perf_counter()
    found = lw.discover(record, masses(chain))
    seconds = perf_counter() - started
    return Peer.of(monomials(found.structure), monomials(chain), seconds)


def by_sindy(n: int, decibel: float, seed: int) -> Peer:
    """The full cubic library on smoothed differences."""
    library = pysindy.PolynomialLibrary(degree=DEGREE, include_bias=False)
    return _searched(n, decibel, seed, library)


def by_weak_sindy(n: int, decibel: float, seed: int) -> Peer:
    """The same library in weak form, three test functions a column."""
    record = chain_record(n, decibel, seed)
    columns = len(list(_powers(2 * n)))
    np.random.seed(seed)  # noqa: NPY002  # where its windows lie is drawn from the global generator
    library = pysindy.WeakPDELibrary(
        function_library=pysindy.PolynomialLibrary(degree=DEGREE, include_bias=False),
        spatiotemporal_grid=np.arange(len(record)) / record.rate,
        K=3 * columns,
        H_xt=[HALF_WINDOW],
        p=4,
    )
    return _searched(n, decibel, seed, library)


def _searched(n: int, decibel: float, seed: int, library) -> Peer:  # type: ignore[no-untyped-def]
    """The fewest wrong monomials over all thresholds; the clock counts one fit, not the search for the threshold."""
    record, truth = chain_record(n, decibel, seed), monomials(lw.bnes_chain(n))
    smooth = pysindy.SmoothedFiniteDifference(smoother_kws=SMOOTHING)
    best: Peer | None = None
    for share in SHARES:
        started = perf_counter()
        x = np.asarray(record.values)
        states = np.hstack([x, smooth(x, 1.0 / record.rate)])
        states = states / np.std(states, axis=0)  # so that a threshold means the same in every equation
        weak = isinstance(library, pysindy.WeakPDELibrary)
        target = library.convert_u_dot_integral(states) if weak else smooth(states, 1.0 / record.rate)
        size = float(np.median(np.linalg.norm(target[:, n:], axis=0)))
        optimizer = pysindy.STLSQ(threshold=share * size, alpha=1e-6, max_iter=10, normalize_columns=True)
        model = pysindy.SINDy(optimizer=optimizer, feature_library=library)
        with warnings.catch_warnings():  # where nothing is left of an equation it warns and goes on
            warnings.simplefilter("ignore")
            model.fit(states, t=1.0 / record.rate, x_dot=None if weak else target)
        seconds = perf_counter() - started
        found = Peer.of(np.asarray(model.coefficients())[n:] != 0.0, truth, seconds)
        if best is None or found.missing + found.extra < best.missing + best.extra:
            best = found
    assert best is not None
    return best
