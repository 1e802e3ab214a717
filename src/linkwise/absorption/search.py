"""The search of designs in the unit cube of their parameters: a Halton sequence, then a population that evolves."""

from __future__ import annotations

import hashlib
import json
import pickle
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np
import scipy

from linkwise import __version__
from linkwise.arrays import Floats
from linkwise.progress import Progress, part

_SCREENED = 0.4  # of a search: points of a Halton sequence, of which the best evolve
_POPULATION = 5  # members for each parameter
LEAST = 8
_MUTATION, _CROSSOVER = (0.2, 0.7), 0.9  # a small one: evaluations are few, and landscapes rough
_ALIKE = 1e-6  # of the mean: members of a population that differ less have converged
_CAPS, _OF_TRADE_OFF = (0.2, 0.4, 0.6, 0.8), 0.4  # of the span of added masses, and of the evaluations
_LOGARITHMIC = 10.0  # ratio of bounds from which a parameter is searched by its logarithm
_INFEASIBLE = 1e30  # above every quantity


@dataclass(frozen=True)
class DesignAxis:
    """A varied parameter: a coefficient or a mass, between `low` and `high` in its SI unit.

    A search is by the logarithm where the bounds are of one sign and a factor of ten apart.

    Attributes
    ----------
    name, unit : str
        As "nes1.alpha" and "N/m".
    low, high : float
        The bounds.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.absorption.DesignAxis("nes1.beta", "N/m^3", 1e5, 1e7).logarithmic
    True
    """

    name: str
    unit: str
    low: float
    high: float

    @property
    def logarithmic(self) -> bool:
        """Whether the search is by the logarithm."""
        ends = sorted((abs(self.low), abs(self.high)))
        return self.low * self.high > 0.0 and ends[1] >= _LOGARITHMIC * ends[0]


def values_at(axis: DesignAxis, ways: Floats) -> Floats:
    """The values at parts 0..1 of the way between the bounds."""
    if axis.logarithmic:
        return np.asarray(axis.low * (axis.high / axis.low) ** ways)
    return np.asarray(axis.low + ways * (axis.high - axis.low))


def way_to(axis: DesignAxis, value: float) -> float:
    """The part of the way between the bounds at which a value lies."""
    if axis.logarithmic:
        ratio = value / axis.low
        return float(np.log(ratio) / np.log(axis.high / axis.low)) if ratio > 0.0 else -1.0
    return (value - axis.low) / (axis.high - axis.low)


class Judge(Protocol):
    """What designs are judged by."""

    @property
    def axes(self) -> tuple[DesignAxis, ...]:
        """The P varied parameters."""

    @property
    def mass_varies(self) -> bool:
        """Whether the mass of the sinks does."""

    def judge(self, points: Floats, progress: Progress) -> Floats:
        """(E, 5) of designs (E, P): the loss, least is best and inf the worst; by what part it exceeds limits; the mass in kg;
        how many runs diverged, and the largest error of an energy balance.
        """


class Journal:
    """Judgements of designs, kept in a file until the search ends, so that one that was interrupted goes on."""

    def __init__(self, path: Path | None, asked: object) -> None:
        self.path, self.judged = path, dict[bytes, list[float]]()
        digest = hashlib.sha256(pickle.dumps((__version__, asked))).hexdigest()
        lines: list[str] = []
        with suppress(OSError, ValueError):
            lines = [] if path is None else path.read_text(encoding="utf-8").splitlines()
        for line in lines[1:] if lines[:1] == [digest] else ():
            with suppress(ValueError):  # of a line that was cut
                for *way, loss, excess, mass, diverged, closure in json.loads(line):
                    self.judged[np.array(way).tobytes()] = [loss, excess, mass, diverged, closure]
        if not self.judged:
            self._write(digest, "w")

    def add(self, ways: Sequence[Floats], judged: Floats) -> None:
        """Keep the judgements (E, 5) of designs."""
        rows = list(zip(ways, judged.tolist(), strict=True))
        self.judged.update({way.tobytes(): row for way, row in rows})
        self._write("\n" + json.dumps([[*way.tolist(), *row] for way, row in rows]), "a")

    def _write(self, text: str, mode: str) -> None:
        if self.path is not None:
            with suppress(OSError), self.path.open(mode, encoding="utf-8") as file:
                file.write(text)


class Search:
    """The designs evaluated so far, each once, and the search for better ones in the unit cube of parameters."""

    def __init__(self, problem: Judge, budget: int, seed: int, journal: Journal, progress: Progress) -> None:
        self.problem, self.budget, self.journal, self.progress = problem, budget, journal, progress
        self.rng = np.random.default_rng(seed)
        self.sequence = scipy.stats.qmc.Halton(len(problem.axes), rng=self.rng)
        self.number: dict[bytes, int] = {}
        self.ways = np.empty((0, len(problem.axes)))
        self.loss, self.excess, self.mass, self.diverged, self.closure = np.empty((5, 0))

    def values(self, ways: Floats) -> Floats:
        """(E, P) the parameters of designs."""
        return np.stack([values_at(axis, ways[:, k]) for k, axis in enumerate(self.problem.axes)], axis=1)

    def merit(self, cap: float = np.inf) -> Floats:
        """(E,) what is minimised: the loss, and beyond limits and the `cap` of the mass in kg what is in excess."""
        excess = np.maximum(self.excess, np.maximum(self.mass / cap - 1.0, 0.0))
        wrong = np.minimum(np.where(np.isinf(self.loss), np.maximum(excess, 1e3), excess), 1e6)
        loss = np.where(np.isinf(self.loss), 0.0, self.loss)
        return np.where(wrong > 0.0, _INFEASIBLE * (1.0 + wrong), loss)

    def evaluate(self, ways: Floats) -> list[int]:
        """The numbers of designs (E, P), those that are new evaluated together, as far as the budget goes."""
        new = {row.tobytes(): row for row in ways if row.tobytes() not in self.number}
        rows = list(new.values())[: max(0, self.budget - len(self.ways))]
        if rows:
            first = len(self.ways)
            self.ways = np.concatenate([self.ways, rows])
            share = part(self.progress, first / self.budget, len(self.ways) / self.budget)
            known = self.journal.judged
            if missing := [row for row in rows if row.tobytes() not in known]:
                self.journal.add(missing, self.problem.judge(self.values(np.array(missing)), share))
            judged = np.array([known[row.tobytes()] for row in self.ways]).T
            self.loss, self.excess, self.mass, self.diverged, self.closure = judged
            self.number.update({row.tobytes(): first + k for k, row in enumerate(rows)})
        worst = int(np.argmax(self.merit()))  # of a design that the budget leaves out
        return [self.number.get(row.tobytes(), worst) for row in ways]

    def judged(self, ways: Floats, cap: float) -> Floats:
        """(E,) the merit of designs."""
        numbers = self.evaluate(ways)
        return self.merit(cap)[numbers]

    def evolve(self, until: int, cap: float = np.inf) -> None:
        """Let the best designs so far evolve until the population has converged or there are `until` designs."""
        size = max(LEAST, _POPULATION * len(self.problem.axes))
        population = self.ways[np.argsort(self.merit(cap), kind="stable")[:size]]
        if (generations := -(-(until - len(self.ways)) // size)) < 1 or len(population) < 5:
            return
        scipy.optimize.differential_evolution(
            lambda ways: self.judged(np.atleast_2d(ways.T), cap),
            [(0.0, 1.0)] * len(self.problem.axes),
            init=population, maxiter=generations, mutation=_MUTATION, recombination=_CROSSOVER, tol=_ALIKE,
            rng=self.rng, polish=False, vectorized=True, updating="deferred",
        )  # fmt: skip

    def run(self) -> None:
        """Spend the budget: screen and evolve, again if that converges early; then under smaller masses, if these vary."""
        varied = self.problem.mass_varies
        main = round(self.budget * (1.0 - _OF_TRADE_OFF)) if varied else self.budget
        while (left := main - len(self.ways)) > 0:
            self.evaluate(self.sequence.random(min(left, max(LEAST, round(_SCREENED * left)))))
            self.evolve(main)
        if varied:
            low, best = float(self.mass.min()), float(self.mass[np.argmin(self.merit())])
            for k, share in enumerate(_CAPS, start=1):
                self.evolve(main + round(k * (self.budget - main) / len(_CAPS)), low + share * (best - low))

    def best(self) -> int | None:
        """The number of the best design; None where none keeps the limits and has a value."""
        merit = self.merit()
        return None if merit.min() >= _INFEASIBLE else int(np.argmin(merit))
