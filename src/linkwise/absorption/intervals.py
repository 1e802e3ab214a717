"""What the sinks of an identified structure do, with intervals: the same question asked of draws from what is known of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from linkwise.absorption.absorb import answer
from linkwise.absorption.comparison import Comparison
from linkwise.absorption.ensemble import Ensemble, run_ensemble
from linkwise.absorption.harvesters import with_harvesters
from linkwise.absorption.options import AbsorptionKeywords, AbsorptionOptions
from linkwise.absorption.quantities import Quantity
from linkwise.absorption.result import Absorption, closure_verdict
from linkwise.absorption.variants import Variants
from linkwise.arrays import Floats
from linkwise.errors import LinkwiseError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Posterior
from linkwise.progress import Progress, part, silent
from linkwise.text import as_text
from linkwise.verdict import Verdict, is_trusted

COVERED = 0.95
_LIVING = 0.9  # of the draws that must come to their end


@dataclass(frozen=True)
class QuantityInterval:
    """A quantity: `value` at the identified numbers, and 95 % of the draws from `lower` to `upper`.

    None stands where there is no value: a mass that does not settle; as the upper end, that it may not. `missing` counts the
    draws without one.
    """

    quantity: Quantity
    value: float | None
    lower: float | None
    upper: float | None
    missing: int


@dataclass(frozen=True, eq=False)
class AbsorptionIntervals:
    """`absorb` of an identified structure, `found`, with what `draws` draws of it (made with `seed`) say of its accuracy.

    `lower`, `upper` (N, P) m bound the envelopes of the primary masses in 95 % of the draws, sample by sample; `diverged`
    counts draws whose motion came to no end, `closure` is the worst error of an energy balance.
    """

    found: Absorption
    draws: int
    seed: int
    quantities: tuple[QuantityInterval, ...]
    lower: Floats
    upper: Floats
    diverged: int
    closure: float

    def quantity(self, name: str) -> QuantityInterval:
        """The one of that name; KeyError lists those there are."""
        for each in self.quantities:
            if each.quantity.name == name:
                return each
        raise KeyError(
            f"{name!r} is not in this answer; there are {', '.join(q.quantity.name for q in self.quantities)}"
        )

    @property
    def trusted(self) -> bool:
        """Whether no verdict forbids trust."""
        return is_trusted(self.verdicts)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether all energy balances close."""
        return tuple(dict.fromkeys((*self.found.verdicts, closure_verdict(self.closure))))

    def to_dict(self) -> dict[str, Any]:
        """What `Absorption.to_dict` says, and the intervals."""
        return {
            **self.found.to_dict(),
            "verdicts": [verdict.name for verdict in self.verdicts],
            "trusted": self.trusted,
            "draws": self.draws,
            "seed": self.seed,
            "diverged": self.diverged,
            "intervals": {
                each.quantity.name: {
                    "title": each.quantity.title,
                    "unit": each.quantity.unit,
                    "value": each.value,
                    "interval": [each.lower, each.upper],
                    "without_value": each.missing,
                }
                for each in self.quantities
            },
        }

    def __str__(self) -> str:
        return as_text(self)


def absorption_intervals(
    identified: Estimate | Posterior,
    options: AbsorptionOptions | None = None,
    *,
    draws: int = 200,
    seed: int = 0,
    workers: int | None = None,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> AbsorptionIntervals:
    """Compare what an identified structure does with its sinks and without them, with 95 % intervals.

    Parameters
    ----------
    identified : Estimate or Posterior
        The identified structure with its covariance.
    options : AbsorptionOptions, optional
        What is asked.
    draws : int
        How many structures are drawn, normally distributed with the covariance.
    seed : int
        Seed of the draws.
    workers : int, optional
        Threads; by default one a processor.
    progress : Progress
        Called with a `ProgressReport` as runs end.
    **keywords
        In place of `options`: its fields and what drives the structure, as in `absorb`.

    Returns
    -------
    AbsorptionIntervals
        The comparison at the identified values, and intervals of its quantities.

    Raises
    ------
    IdentificationError
        If the estimate is not to be trusted, or its bounds leave no draws.
    LinkwiseError
        If `draws` is less than 2, or more than a tenth of the draws diverge.
    StructureError, SimulationError
        As `absorb` does.
    """
    asked = AbsorptionOptions.given(options, keywords)
    known = identified if isinstance(identified, Posterior) else Posterior.of(identified)
    if draws < 2:
        raise LinkwiseError(f"{draws} draws tell no interval; ask for 100 or more")
    trial = Comparison.of(known.structure, asked)
    found = answer(trial, part(progress, 0.0, 0.1))
    variants = Variants(with_harvesters(known.structure, asked.harvesters or {}), trial, known.names)
    table = known.draws(draws, seed)
    trials = [variants.at(dict(zip(known.names, row.tolist(), strict=True))) for row in table]
    itself = run_ensemble([trial], alone=True).values[0]
    told = run_ensemble(trials, envelopes=True, workers=workers, progress=part(progress, 0.1, 1.0))
    living = told.alive
    if np.mean(living) < _LIVING:
        raise LinkwiseError(
            f"the motion of {int(np.sum(~living))} of {draws} draws diverges: what is known of the structure does not say "
            "whether it holds; measure longer, or with less noise"
        )
    lower, upper = _bands(told)
    return AbsorptionIntervals(
        found=found,
        draws=draws,
        seed=seed,
        quantities=tuple(
            _likely(quantity, itself[column], told.values[living, column])
            for column, quantity in enumerate(told.quantities)
            if quantity.name != "closure"
        ),
        lower=lower,
        upper=upper,
        diverged=int(np.sum(~living)),
        closure=float(np.nanmax(told.column("closure"))),
    )


def _bands(told: Ensemble) -> tuple[Floats, Floats]:
    assert told.envelopes is not None
    tail = 100.0 * 0.5 * (1.0 - COVERED)
    lower, upper = np.percentile(told.envelopes[..., told.alive], [tail, 100.0 - tail], axis=2)
    return np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)


def _likely(quantity: Quantity, value: float, drawn: Floats) -> QuantityInterval:
    """Quantiles of the draws; what never happens happens after every time."""
    tail = 0.5 * (1.0 - COVERED)
    missing = int(np.sum(np.isnan(drawn)))
    ranked = np.sort(np.where(np.isnan(drawn), np.inf, drawn))
    ends = ranked[[int(np.floor(tail * (len(ranked) - 1))), int(np.ceil((1.0 - tail) * (len(ranked) - 1)))]]
    return QuantityInterval(quantity, _known(value), _known(ends[0]), _known(ends[1]), missing)


def _known(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


def without_intervals(answer: Absorption | AbsorptionIntervals) -> Absorption:
    """The comparison itself, of an answer with intervals or of one without."""
    return answer.found if isinstance(answer, AbsorptionIntervals) else answer
