"""`absorb` of an identified structure with intervals: the same comparison for draws from its posterior."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Unpack

import numpy as np

from linkwise.absorption.absorb import AbsorptionKeywords, AbsorptionOptions, Comparison, compare
from linkwise.absorption.ensemble import (
    AbsorptionQuantity,
    BaselineQuantities,
    quantity_values,
    run_ensemble,
    variants,
)
from linkwise.absorption.result import Absorption, Rows, closure_verdict
from linkwise.absorption.sinks import with_harvesters
from linkwise.arrays import Floats, finite
from linkwise.display import JudgedView, align_columns
from linkwise.errors import LinkwiseError, expect, options_given, require_known
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Posterior
from linkwise.progress import Progress, part, silent
from linkwise.verdict import UNGRADED, Basis, Verdict

_TAIL = 0.5 * (1.0 - 0.95)  # of the draws, beyond either end of an interval
_LEAST_COMPLETED = 0.9  # of the draws


@dataclass(frozen=True)
class QuantityInterval:
    """A quantity at the identified values, and its 95 % interval.

    Attributes
    ----------
    quantity : AbsorptionQuantity
        What it is, and its unit.
    value : float or None
        At the identified values; None if it does not exist, as the settling time of a mass that does not settle.
    lower, upper : float or None
        Ends of the interval; `upper` is None if it may not exist.
    missing : int
        The number of draws without a value.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="ml")
    >>> result = lw.absorption.absorption_intervals(fit, duration=0.5, draws=20, release={"v:m1": 1.0})
    >>> interval = result.quantity("rms_reduction")
    >>> interval.quantity.title, interval.lower < interval.value < interval.upper
    ('RMS reduction', True)
    """

    quantity: AbsorptionQuantity
    value: float | None
    lower: float | None
    upper: float | None
    missing: int


@dataclass(frozen=True, eq=False, repr=False)
class AbsorptionIntervals(JudgedView):
    """The result of `absorption_intervals`; printed, that of `absorb` and a table of intervals.

    Attributes
    ----------
    absorption : Absorption
        The result at the identified values.
    draws : int
        The number of draws from the posterior.
    seed : int
        The seed that they were made with.
    quantities : tuple of QuantityInterval
        The quantities with intervals.
    lower, upper : (N, P) ndarray
        Bounds in m of the envelopes of the primary masses in 95 % of the draws, sample by sample.
    diverged : int
        The number of draws whose motion diverged.
    closure : float
        The largest error of an energy balance, as a part of the energy supplied.
    basis : Basis
        The answer that the structure comes from.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="ml")
    >>> result = lw.absorption.absorption_intervals(fit, duration=0.5, draws=20, release={"v:m1": 1.0})
    >>> result.draws, result.lower.shape == result.upper.shape == (len(result.absorption.time), 1)
    (20, True)
    >>> result.trusted
    True
    """

    absorption: Absorption
    draws: int
    seed: int
    quantities: tuple[QuantityInterval, ...]
    lower: Floats
    upper: Floats
    diverged: int
    closure: float
    basis: Basis = UNGRADED

    def quantity(self, name: str) -> QuantityInterval:
        """The quantity called `name`.

        Parameters
        ----------
        name : str
            A name such as "rms_reduction" or "settled:m1".

        Returns
        -------
        QuantityInterval
            Its value and interval.

        Raises
        ------
        LinkwiseError
            If there is none; the message lists all.
        """
        known = {interval.quantity.name: interval for interval in self.quantities}
        require_known("quantity", name, known)
        return known[name]

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether all energy balances close."""
        return tuple(dict.fromkeys((*self.absorption.verdicts, closure_verdict(self.closure))))

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data: that of `Absorption.to_dict`, and the intervals.

        Returns
        -------
        dict
            What `Absorption.to_dict` returns at the identified values, and "intervals" by name of the quantity.
        """
        return {
            **self.absorption.to_dict(),
            **self._judgement(),
            "draws": self.draws,
            "seed": self.seed,
            "diverged": self.diverged,
            "intervals": {
                interval.quantity.name: {
                    "title": interval.quantity.title,
                    "unit": interval.quantity.unit,
                    "value": interval.value,
                    "interval": [interval.lower, interval.upper],
                    "without_value": interval.missing,
                }
                for interval in self.quantities
            },
        }

    def __str__(self) -> str:
        rows: Rows = [(*row, "") for row in interval_rows(self)]
        table = "\n".join([interval_headline(self), *align_columns(rows)])
        return f"{self.absorption}\n\n{table}"


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
    """Compare the vibration of an identified structure with its sinks and without them, with 95 % intervals.

    The comparison of `absorb` is made for normal draws with the covariance of the estimate.

    Parameters
    ----------
    identified : Estimate or Posterior
        What was identified.
    options : AbsorptionOptions, optional
        What to simulate.
    draws : int
        The number of draws, at least 2.
    seed : int
        Seed of the draws.
    workers : int, optional
        Number of threads; by default one for each processor.
    progress : Progress
        Called with a `ProgressReport` as runs end.
    **keywords
        In place of `options`: its fields and the excitation, as in `absorb`.

    Returns
    -------
    AbsorptionIntervals
        The result at the identified values, and intervals of all quantities.

    Raises
    ------
    IdentificationError
        If the estimate is not to be trusted, or its bounds leave no draws.
    LinkwiseError
        If there are fewer than 2 draws, or the motion of more than a tenth of them diverges.
    StructureError, SimulationError
        As `absorb`.
    TypeError
        If `identified` has another type.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> fit = lw.identify(record, chain.unknown("nes"), method="ml")
    >>> found = lw.absorption.absorption_intervals(fit, duration=0.5, draws=20, release={"v:m1": 1.0})
    >>> share = found.quantity("sinks_share")
    >>> share.lower < share.value < share.upper
    True
    """
    expect("absorption_intervals(identified): identified", identified, Estimate, Posterior)
    posterior = identified if isinstance(identified, Posterior) else Posterior.of(identified)
    if draws < 2:
        message = f"intervals need at least 2 draws, got {draws}; use 100 or more"
        raise LinkwiseError(message, arguments=("draws",))
    comparison = Comparison.of(posterior.structure, options_given(AbsorptionOptions.of, options, keywords))
    absorption = compare(comparison, part(progress, 0.0, 0.1))
    without = BaselineQuantities.of(absorption.without, comparison.options.settle)
    by_name = quantity_values(comparison, absorption.with_sinks, without)
    equipped = with_harvesters(posterior.structure, comparison.options.harvesters or {})
    at = variants(equipped, comparison, posterior.names)
    drawn = [
        at(dict(zip(posterior.names, row, strict=True))) for row in posterior.draws(draws, seed).tolist()
    ]
    ensemble = run_ensemble(drawn, envelopes=True, workers=workers, progress=part(progress, 0.1, 1.0))
    completed = ensemble.completed
    if np.mean(completed) < _LEAST_COMPLETED:
        raise LinkwiseError(
            f"the motion of {int(np.sum(~completed))} of {draws} draws diverges: the identified structure may be unstable "
            "within its uncertainty; measure for longer, or with less noise"
        )
    assert ensemble.envelopes is not None
    shares = [100.0 * _TAIL, 100.0 * (1.0 - _TAIL)]
    lower, upper = np.percentile(ensemble.envelopes[completed], shares, axis=0).astype(float)
    values = (float(by_name[quantity.name]) for quantity in ensemble.quantities)
    columns = zip(ensemble.quantities, values, ensemble.values[completed].T, strict=True)
    return AbsorptionIntervals(
        absorption=absorption,
        draws=draws,
        seed=seed,
        quantities=tuple(_interval_of_draws(*column) for column in columns if column[0].name != "closure"),
        lower=lower,
        upper=upper,
        diverged=int(np.sum(~completed)),
        closure=float(np.nanmax(ensemble.column("closure"))),
        basis=posterior.basis,
    )


def _interval_of_draws(quantity: AbsorptionQuantity, value: float, drawn: Floats) -> QuantityInterval:
    """The quantiles of the draws; a missing value, of what never happens, is larger than all others."""
    missing, ranked = int(np.sum(np.isnan(drawn))), np.where(np.isnan(drawn), np.inf, drawn)
    lower = np.quantile(ranked, _TAIL, method="lower")
    upper = np.quantile(ranked, 1.0 - _TAIL, method="higher")
    return QuantityInterval(quantity, finite(value), finite(lower), finite(upper), missing)


Answer = Absorption | AbsorptionIntervals
"""What `absorb` says of a structure, and of an identified one."""


def without_intervals(result: Answer) -> Absorption:
    """The comparison itself, of a result with intervals or of one without."""
    return result.absorption if isinstance(result, AbsorptionIntervals) else result


def interval_headline(intervals: AbsorptionIntervals) -> str:
    """What the intervals are, in a sentence."""
    diverged = f", of which {intervals.diverged} diverged" if intervals.diverged else ""
    return f"95 % of {intervals.draws} draws of the identified structure (seed {intervals.seed}){diverged} lie within:"


def interval_rows(intervals: AbsorptionIntervals) -> Rows:
    """Each quantity at the identified values, and its interval."""
    rows: Rows = [("quantity", "identified", "95 % interval")]
    for own in intervals.quantities:
        ends = _end_text(own, own.lower) + ("" if own.lower is None else f" to {_end_text(own, own.upper)}")
        rows.append((own.quantity.title, _end_text(own, own.value), ends))
    return rows


def _end_text(interval: QuantityInterval, value: float | None) -> str:
    if value is None:
        return "never" if interval.quantity.name.startswith("settled") else "-"
    return interval.quantity.text(value)
