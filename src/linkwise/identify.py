"""From a record and a structure with unknowns to the force law of every link."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from linkwise.derive import Method as Derivative
from linkwise.derive import differentiate
from linkwise.errors import IdentificationError
from linkwise.estimate import CHI_SQUARE_OFF, CONVERGED, NOT_CONVERGED, Estimate, NoiseEstimate
from linkwise.library import link_columns
from linkwise.likelihood.anneal import Progress
from linkwise.likelihood.answer import likelihood_estimate
from linkwise.likelihood.loss import Loss
from linkwise.linkmotion import LinkMotion, weak_residual
from linkwise.motion import SeenMotion, noise_variance, read_motion
from linkwise.record import Record
from linkwise.sparse.l1 import L1
from linkwise.sparse.least_squares import LeastSquares
from linkwise.sparse.regressor import Regressor
from linkwise.sparse.stlsq import Stlsq
from linkwise.structure import Structure
from linkwise.weak import WeakEquations, weak_equations
from linkwise.weakfit import WeakFit, weak_fit

Floats = NDArray[np.float64]
Method = Literal["ml", "weak", "sindy"]
_METHODS = ("ml", "weak", "sindy")

_LARGEST_EXCESS = 2.0  # residual power over what noise explains; wrong laws and wrong noise leave far more
_STEPS = 40  # of Gauss-Newton for coefficients that enter a law nonlinearly
_SMALL = 1e-3  # of a standard error: a step below it changes nothing that anybody can see
_REGRESSORS: dict[str, type[Regressor]] = {"stlsq": Stlsq, "l1": L1, "least-squares": LeastSquares}


@dataclass(frozen=True)
class Classical:
    """How the paper's method is run: `derivative` "spline", "savgol" or "differences", then `regressor` "least-squares",
    "stlsq" or "l1".
    """

    derivative: Derivative = "spline"
    regressor: str = "stlsq"

    def __post_init__(self) -> None:
        if self.regressor not in _REGRESSORS:
            raise IdentificationError(
                f'"{self.regressor}" is no regressor; there are {", ".join(_REGRESSORS)}'
            )


def identify(
    record: Record | Sequence[Record],
    structure: Structure,
    *,
    method: Method = "ml",
    starts: Mapping[str, float] | None = None,
    offsets: Sequence[str] = (),
    loss: Loss | None = None,
    classical: Classical | None = None,
    progress: Callable[[Progress], None] | None = None,
) -> Estimate:
    """The unknown coefficients and masses of `structure` from `record`, or from several records of it together ("ml").

    `method` "ml" (default, METHODS section 5: maximum likelihood on the raw samples), "weak" (section 4: no signal is
    differentiated, noise bias removed; milliseconds) or "sindy" (the paper's physics-informed SINDy, run as `classical` says).
    For "ml" only: `starts` of parameters by name (else the weak fit's), `offsets` names channels with an unknown constant
    error,
    `loss` is Gaussian() or, against outliers, Huber() or Student(), and `progress` is told every step.

    Raises IdentificationError where the records cannot tell an unknown at all.
    """
    records = [record] if isinstance(record, Record) else list(record)
    if method not in _METHODS:
        raise IdentificationError(f'"{method}" is no method; there are {", ".join(_METHODS)}')
    if not records:
        raise IdentificationError("there is no record to identify from")
    if not structure.parameters:
        raise IdentificationError(
            'there is nothing to identify, every coefficient is a number: write "unknown" for those to be found'
        )
    if method != "ml" and (len(records) > 1 or starts or offsets or loss is not None):
        raise IdentificationError(
            f'several records, starts, offsets and a loss are for method "ml", not for "{method}"'
        )
    started = perf_counter()
    if method == "ml":
        estimate = likelihood_estimate(
            records, structure, starts=starts, offsets=offsets, loss=loss, report=progress
        )
    elif method == "weak":
        estimate = _weak(records[0], structure)
    else:
        estimate = _sindy(records[0], structure, classical or Classical())
    return replace(estimate, seconds=perf_counter() - started)


def _weak(record: Record, structure: Structure) -> Estimate:
    motion = read_motion(record, structure)
    equations, fit, settled = _settled(record, structure, motion)
    status, message = _judged(fit.excess, settled)
    found = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    return Estimate(
        method="weak",
        status=status,
        message=message,
        seconds=0.0,
        asked=structure,
        parameters=structure.parameters,
        values=fit.values,
        covariance=fit.covariance,
        free=fit.free,
        noise=_noise(record, structure, motion),
        chi_square_per_sample=fit.excess,
        samples=motion.samples,
        motion=_link_motion(structure.with_values(found), equations, fit.values),
        record=record,
        remarks=_remarks(record),
    )


def _settled(record: Record, structure: Structure, motion: SeenMotion) -> tuple[WeakEquations, WeakFit, bool]:
    """One regression; Gauss-Newton around it while coefficients enter a law nonlinearly."""
    curved = _nonlinear(structure)
    if not curved:
        equations = weak_equations(record, structure, motion)
        return equations, weak_fit(equations, structure), True
    starts = {p.name: p.start for p in structure.parameters if p.name in curved and p.start is not None}
    held = structure.with_values(starts)
    values = dict(starts)
    if held.parameters:
        equations = weak_equations(record, held, motion)
        values.update(zip(equations.parameters, map(float, weak_fit(equations, held).values), strict=True))
    for _ in range(_STEPS):
        equations = weak_equations(record, structure, motion, values=values)
        fit = weak_fit(equations, structure)
        step = np.array([fit.values[i] - values[name] for i, name in enumerate(equations.parameters)])
        deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
        if np.all(np.abs(step) <= np.maximum(_SMALL * deviations, 1e-9 * np.abs(fit.values))):
            return equations, fit, True
        values = dict(zip(equations.parameters, map(float, fit.values), strict=True))
    return equations, fit, False


def _nonlinear(structure: Structure) -> set[str]:
    """The parameters that enter a law nonlinearly."""
    return {
        parameter.name
        for parameter in structure.parameters
        if any(index >= 0 and key in structure.links[index].law.nonlinear for index, key in parameter.members)
    }


def _judged(excess: float, settled: bool) -> tuple[str, str]:
    if not settled:
        return NOT_CONVERGED, (
            f"The search for the coefficients that enter a law nonlinearly did not settle in {_STEPS} steps; start it "
            "nearer, or bound them."
        )
    if not excess < _LARGEST_EXCESS:
        return CHI_SQUARE_OFF, (
            f"The residuals are {np.sqrt(excess):.3g} times what the noise explains, so no interval is given: a term is "
            "missing from a law, a link from the structure, or the noise is not white. The values are the best of these laws."
        )
    return CONVERGED, "The laws explain the record to within its noise."


def _noise(record: Record, structure: Structure, motion: SeenMotion) -> dict[str, NoiseEstimate]:
    variances = [*zip(structure.mass_names, motion.variance, motion.seen, strict=True)]
    found = {f"x:{name}": variance for name, variance, seen in variances if seen}
    if motion.base is not None:
        found["x:base"] = motion.base_variance
    return {
        name: NoiseEstimate.of(record, name, float(np.sqrt(variance))) for name, variance in found.items()
    }


def _link_motion(identified: Structure, equations: WeakEquations, values: Floats) -> LinkMotion:
    return LinkMotion(
        identified, equations.time, equations.d.T, equations.v.T, partial(weak_residual, equations, values)
    )


def _remarks(record: Record) -> tuple[str, ...]:
    lost = int(record.missing.sum())
    return (f"{lost} samples are missing; equations that need them are left out.",) if lost else ()


def _sindy(record: Record, structure: Structure, classical: Classical) -> Estimate:
    states = differentiate(record, classical.derivative)
    system = link_columns(states, structure)
    fit = _REGRESSORS[classical.regressor]().fit(system)
    values = fit.coefficients[:, 0]
    dropped = [name for name, kept in zip(fit.names, fit.support[:, 0], strict=True) if not kept]
    identified = structure.with_values(dict(zip(fit.names, map(float, values), strict=True)))
    order = [states.masses.index(name) for name in structure.mass_names]
    motion = LinkMotion(
        identified,
        states.time,
        identified.elongations(states.x[:, order], states.base),
        identified.elongations(states.v[:, order], states.base_velocity),
        lambda: (system.matrix @ values - system.target[:, 0]).reshape(structure.size, len(states)).T,
    )
    named = [name for name in record.responses if name.startswith("x:")]
    samples = np.stack([record.channel(name) for name in named]) if named else np.empty((0, len(record)))
    sigma = np.sqrt(noise_variance(record, named, samples)) if named else np.empty(0)
    unexplained = float(fit.residual[0])
    return Estimate(
        method="sindy",
        status=CONVERGED,
        message=(
            f"Sparse regression on derivatives leaves {100.0 * unexplained:.3g} % of the forces unexplained. Its standard "
            "errors take samples as independent, which derivatives are not, so no interval is given: method weak has them."
        ),
        seconds=0.0,
        asked=structure,
        parameters=structure.parameters,
        values=values,
        covariance=np.diag(fit.standard_error[:, 0] ** 2),
        free=np.ones(len(values), dtype=bool),
        intervals=False,
        noise={name: NoiseEstimate.of(record, name, float(s)) for name, s in zip(named, sigma, strict=True)},
        chi_square_per_sample=None,
        samples=len(states) * len(states.masses),
        motion=motion,
        record=record,
        remarks=tuple(f"{name} was dropped: its term adds less than the threshold." for name in dropped),
    )
