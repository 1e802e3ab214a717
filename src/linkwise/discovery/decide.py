"""The likelihood decides: fit, look along the parabola at every candidate, change the choice, fit again."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.typing import NDArray

from linkwise.discovery.candidates import Candidates
from linkwise.discovery.price import Price
from linkwise.discovery.quadratic import Quadratic
from linkwise.discovery.stepwise import best, improved
from linkwise.likelihood.anneal import Progress, Status
from linkwise.likelihood.fit import LikelihoodFit, Options, likelihood_fit
from linkwise.likelihood.parabola import Force, parabola
from linkwise.record import Record
from linkwise.structure import Structure

Floats = NDArray[np.float64]

_ROUNDS = 12
_STEPS = 40  # of a fit whose laws may still be wrong; right ones take a quarter of it
_EXACT = 1e-4  # q up to which a parabola tells the whole truth; a looser one serves for the next best terms only
_CEILING = 1.05  # chi-square at which a fit stops tightening: something is missing, and may be told already


@dataclass(frozen=True, eq=False)
class Decided:
    """The `structure` of the `chosen` candidates, its `fit`, and the cost around it in all candidates that were tested."""

    chosen: frozenset[str]
    structure: Structure
    fit: LikelihoodFit
    quadratic: Quadratic
    price: Price
    settled: bool
    rounds: int


Start = Callable[[Structure], tuple[Floats, Floats | None]]


def decided(
    records: Sequence[Record],
    candidates: Candidates,
    chosen: Collection[str],
    *,
    tested: Collection[str],
    start: Start,
    report: Callable[[int, Progress], None] = lambda number, done: None,
) -> Decided:
    """The choice, from `chosen` on, that no candidate in `tested` improves; `start` tells theta and deviations.

    `settled` is False where the rounds ran out, or where the choice came back to one it had left. `report` is told the round
    and its steps.
    """
    samples = sum(int(np.isfinite(record.select(record.responses).values).sum()) for record in records)
    now, seen = frozenset(chosen), set[frozenset[str]]()
    structure = candidates.structure(now)
    theta, spread = start(structure)
    nodes = None
    for number in range(1, _ROUNDS + 1):
        fit = likelihood_fit(
            records,
            structure,
            theta,
            spread=spread,
            options=Options(
                report=partial(report, number),
                nodes=nodes,
                model_error=False,
                ceiling=_CEILING,
                steps=_STEPS,
            ),
        )
        quadratic = _quadratic(fit, structure, candidates, frozenset(tested) - now)
        price = Price.of(candidates, quadratic.names, samples)
        inside = list(range(len(structure.parameters)))
        after = improved(quadratic, price, inside) if fit.optimum.q > _EXACT else inside
        if after == inside:
            after = best(quadratic, price, inside)
        names = frozenset(quadratic.names[k] for k in after if quadratic.names[k] in candidates.by_name)
        seen.add(now)
        if names == now or names in seen or fit.status is Status.INTERRUPTED or number == _ROUNDS:
            return Decided(now, structure, fit, quadratic, price, names == now, number)
        solved = quadratic.solve(after)
        found = {quadratic.names[k]: value for k, value in zip(after, solved.values, strict=True)}
        error = {quadratic.names[k]: abs(value / z) for k, value, z in zip(after, solved.values, solved.z, strict=True)}
        now, structure = names, candidates.structure(names)
        theta = np.array([found[p.name] for p in structure.parameters])
        spread = np.array([error[p.name] for p in structure.parameters])
        nodes = fit.optimum.point.nodes
    raise AssertionError("the last round returns")


def _quadratic(
    fit: LikelihoodFit, structure: Structure, candidates: Candidates, outside: Collection[str]
) -> Quadratic:
    """The cost about the fit, in its parameters and, behind them, the candidates `outside`."""
    index = {name: number for number, name in enumerate(structure.mass_names)}
    index |= {"ground": -1, "base": -2}
    added = [entry for entry in candidates.entries if entry.name in outside]
    ends = [candidates.pairs[entry.pair].between for entry in added]
    forces = [
        Force(index[first], index[second], entry.term.law)
        for entry, (first, second) in zip(added, ends, strict=True)
    ]
    found = parabola(fit.optimum, forces)
    names = (*(p.name for p in structure.parameters), *(entry.name for entry in added))
    return Quadratic(names, found.curvature, found.slope)
