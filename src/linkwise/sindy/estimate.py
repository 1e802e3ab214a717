"""Physics-informed SINDy: states by differentiation, one column per coefficient of a link, sparse regression."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import ClassVar, final, get_args

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError
from linkwise.estimates.causes import NoiseEstimate
from linkwise.estimates.estimate import Estimate, Estimator
from linkwise.estimates.link_estimate import LinkMotion, extremes
from linkwise.model.link import refuse_memory
from linkwise.model.structure import Structure, refuse_hosts, refuse_rig
from linkwise.progress import Progress
from linkwise.records.record import Record
from linkwise.signals.noise import noise_deviations
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.signals.states import States, differentiate
from linkwise.sindy.library import link_columns
from linkwise.sindy.regression import REGRESSORS
from linkwise.sindy.regression.linear_system import DenseSystem
from linkwise.verdict import Verdict

MAX_UNEXPLAINED = 0.1  # share of the forces (rms): columns with as much noise bias a slope by its square, 1 %


@final
@dataclass(frozen=True)
class PhysicsInformedSindy(Estimator):
    """Physics-informed sparse identification (SINDy): sparse regression on differentiated channels.

    The library has one column per unknown coefficient of a link. It needs a displacement channel for every mass and laws that
    are linear in their unknowns, and gives no intervals.

    Parameters
    ----------
    derivative : {"spline", "savgol", "differences"}, optional
        Method of differentiation; a spline by default.
    regressor : {"stlsq", "l1", "least-squares"}, optional
        Regression: `Stlsq`, by default, `L1` or `LeastSquares`, each with its defaults.

    Raises
    ------
    IdentificationError
        If the regressor is unknown.

    Notes
    -----
    The library of all monomials (the paper's Eq. 3) is available step by step: `differentiate`, `monomial_equations` and a
    regressor. See S. L. Brunton, J. L. Proctor and J. N. Kutz, PNAS 113, 3932 (2016), for the method.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=6.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> estimate = lw.identify(record, chain.unknown("nes"), method=lw.PhysicsInformedSindy())
    >>> estimate.method
    'sindy'

    On states and derivatives without noise, the library of monomials finds the equations of the chain:

    >>> fit = lw.sindy.Stlsq().fit(lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=3))
    >>> print(fit.text(digits=4).splitlines()[3])
    x2'' = -1e+08*x2**3 + 3e+08*x1*x2**2 + 1e+04*x2 - 3e+08*x1**2*x2 - 1e+04*x1 - 2*v2 + 1e+08*x1**3 + 2*v1
    """

    method: ClassVar[str] = "sindy"

    derivative: Derivative = field(
        default="spline",
        metadata={"typed": "METHOD", "choices": {name: name for name in get_args(Derivative)}},
    )
    regressor: str = field(default="stlsq", metadata={"typed": "METHOD", "choices": REGRESSORS})

    def __post_init__(self) -> None:
        REGRESSORS.lookup(self.regressor)

    def estimate(self, records: Sequence[Record], structure: Structure, progress: Progress) -> Estimate:
        """Estimate the unknowns of a structure by sparse regression.

        Parameters
        ----------
        records : sequence of Record
            A single record.
        structure : Structure
            The structure, with one unknown at least.
        progress : Progress
            Not called: the regression is one step.

        Returns
        -------
        Estimate
            The answer, without intervals.

        Raises
        ------
        RecordError
            If derivatives cannot be formed.
        IdentificationError
            If there are several records, a law is not linear in an unknown, or the columns are collinear.
        """
        refuse_rig(structure, 'method "sindy"')
        refuse_memory(structure.links, 'method "sindy"', "maximum likelihood takes it")
        refuse_hosts(structure, 'method "sindy"')
        record = self.only_record(records)
        _require_no_priors(structure)
        states = differentiate(record, self.derivative)
        system = link_columns(states, structure)
        fit = REGRESSORS.lookup(self.regressor)().fit(system)
        values = fit.coefficients[:, 0]
        dropped = [name for name, selected in zip(fit.names, fit.support[:, 0], strict=True) if not selected]
        identified = structure.with_values(dict(zip(fit.names, map(float, values), strict=True)))
        verdict, message = _verdict(float(fit.residual[0]))
        residual = partial(_residual, system, values, structure.size)
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
            compute_motion=partial(_link_motion, states, identified, residual),
            record=record,
            remarks=tuple(f"{name} was dropped: its term adds less than the threshold." for name in dropped),
        )


def _link_motion(states: States, identified: Structure, compute_residual: Callable[[], Floats]) -> LinkMotion:
    """Motion of the links of `identified`; `compute_residual` as in LinkMotion."""
    order = [states.masses.index(name) for name in identified.mass_names]
    d = identified.elongations(states.x[:, order], states.base)
    v = identified.elongations(states.v[:, order], states.base_velocity)
    return LinkMotion(identified, states.time, d, v, extremes(d), compute_residual)


def _residual(system: DenseSystem, values: Floats, size: int) -> Floats:
    """Residuals (N, n) in N of the equations of the n = `size` masses."""
    return (system.matrix @ values - system.target[:, 0]).reshape(size, -1).T


def _verdict(unexplained: float) -> tuple[Verdict, str]:
    summary = f"Sparse regression on derivatives leaves {100.0 * unexplained:.3g} % of the forces unexplained"
    if unexplained > MAX_UNEXPLAINED:
        return Verdict.UNEXPLAINED_FORCES, (
            f"{summary}: a term is missing, or noise in the derivatives hides them. Noise in the columns biases the "
            'values towards zero by an unknown amount; methods "weak" and "ml" correct for it.'
        )
    return Verdict.NO_INTERVALS, (
        f"{summary}. Its standard errors assume independent samples and noise-free columns, which derivatives do not give, so "
        'no interval is given; methods "weak" and "ml" give intervals.'
    )


def _noise(record: Record) -> dict[str, NoiseEstimate]:
    named = [name for name in record.responses if name.kind == "x"]
    deviations = zip(named, noise_deviations(record, named), strict=True)
    return {name: NoiseEstimate.of(record, name, float(sigma)) for name, sigma in deviations}


def _require_no_priors(structure: Structure) -> None:
    known = [parameter.name for parameter in structure.parameters if parameter.sigma < np.inf]
    if known:
        raise IdentificationError(
            f"sparse regression takes no account of what is known beforehand, and {', '.join(known)} is stated with a sigma: "
            'use method "ml" or "weak", or leave sigma out'
        )
