"""The answer of the paper's physics-informed SINDy: states by derivatives, columns by link, sparse regression."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import ClassVar, final

import numpy as np

from linkwise.arrays import Floats
from linkwise.estimates.estimate import Estimate, NoiseEstimate
from linkwise.estimates.estimator import Estimator
from linkwise.estimates.link_motion import LinkMotion, extremes
from linkwise.model.structure import Structure
from linkwise.progress import Progress
from linkwise.records.record import Record
from linkwise.signals.channel_noise import noise_variance
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.signals.states import States, differentiate
from linkwise.sindy.library import link_columns
from linkwise.sindy.regression import REGRESSORS
from linkwise.sindy.regression.linear_system import DenseSystem
from linkwise.verdict import Verdict

_MOST = 0.1  # of the forces, root mean square: regressors with as much noise would bend a slope by its square, 1 %


@final
@dataclass(frozen=True)
class PhysicsInformedSindy(Estimator):
    """How the paper's method is run: `derivative` "spline", "savgol" or "differences", then `regressor`, a name in
    `REGRESSORS`: "stlsq", "l1" or "least-squares". Raises IdentificationError for another regressor.

    Its library has one column per coefficient of a link. The paper's library of all monomials is had step by step; on states
    and derivatives without noise it finds the equations of the two-mass chain:

    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> fit = lw.Stlsq().fit(lw.monomial_equations(lw.differentiate(record), order=3))
    >>> print(fit.text(digits=4).splitlines()[3])
    x2'' = -1e+08*x2**3 + 3e+08*x1*x2**2 + 1e+04*x2 - 3e+08*x1**2*x2 - 1e+04*x1 - 2*v2 + 1e+08*x1**3 + 2*v1
    """

    method: ClassVar[str] = "sindy"

    derivative: Derivative = "spline"
    regressor: str = "stlsq"

    def __post_init__(self) -> None:
        REGRESSORS.lookup(self.regressor)

    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """The unknowns by sparse regression.

        Raises RecordError where derivatives cannot be formed, IdentificationError where a law is not linear in an unknown.
        """
        record = self.only_record(records)
        states = differentiate(record, self.derivative)
        system = link_columns(states, structure)
        fit = REGRESSORS.lookup(self.regressor)().fit(system)
        values = fit.coefficients[:, 0]
        dropped = [name for name, kept in zip(fit.names, fit.support[:, 0], strict=True) if not kept]
        identified = structure.with_values(dict(zip(fit.names, map(float, values), strict=True)))
        verdict, message = _judged(float(fit.residual[0]))
        return Estimate(
            method="sindy",
            fit_verdicts=(verdict,),
            message=message,
            seconds=0.0,
            given_structure=structure,
            parameters=structure.parameters,
            values=values,
            covariance=np.diag(fit.standard_error[:, 0] ** 2),
            free=np.ones(len(values), dtype=bool),
            intervals=False,
            noise=_noise(record),
            chi_square_per_sample=None,
            samples=len(states) * len(states.masses),
            compute_motion=partial(
                _moved, states, identified, partial(_residual, system, values, structure.size)
            ),
            record=record,
            remarks=tuple(f"{name} was dropped: its term adds less than the threshold." for name in dropped),
        )


def _moved(states: States, identified: Structure, leave: Callable[[], Floats]) -> LinkMotion:
    """The motion of the links of `identified`; `leave` as in LinkMotion."""
    order = [states.masses.index(name) for name in identified.mass_names]
    d = identified.elongations(states.x[:, order], states.base)
    v = identified.elongations(states.v[:, order], states.base_velocity)
    return LinkMotion(
        structure=identified, time=states.time, d=d, v=v, d_range=extremes(d), compute_residual=leave
    )


def _residual(system: DenseSystem, values: Floats, size: int) -> Floats:
    """(R, n) what `values` leave of the equations of `size` masses in N."""
    return (system.matrix @ values - system.target[:, 0]).reshape(size, -1).T


def _judged(unexplained: float) -> tuple[Verdict, str]:
    told = f"Sparse regression on derivatives leaves {100.0 * unexplained:.3g} % of the forces unexplained"
    if unexplained > _MOST:
        return Verdict.UNEXPLAINED_FORCES, (
            f"{told}: a term is missing, or noise in the derivatives hides them. What noise there is in the columns pulls the "
            'values towards zero, and nothing here tells by how much; methods "weak" and "ml" take it out.'
        )
    return Verdict.NO_INTERVALS, (
        f"{told}. Its standard errors take samples as independent and columns as free of noise, which derivatives are not, so "
        'no interval is given: methods "weak" and "ml" have them.'
    )


def _noise(record: Record) -> dict[str, NoiseEstimate]:
    named = [name for name in record.responses if name.startswith("x:")]
    variances = noise_variance(record, named, np.stack([record.channel(name) for name in named]))
    return {
        name: NoiseEstimate.of(record, name, float(np.sqrt(variance)))
        for name, variance in zip(named, variances, strict=True)
    }
