"""The result of a validation, and its text."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import (
    JudgedView,
    format_error,
    format_value,
    listed,
    paragraph,
    remark_lines,
    table,
    text_of,
)
from linkwise.inspection.inspect import unanswered_alerts
from linkwise.inspection.result import Alert
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.verdict import UNGRADED, Basis, Verdict

_SHOWN = 25.0  # % of the mean square: a prediction that leaves no more than half the motion shows it


@dataclass(frozen=True)
class ChannelPrediction:
    """How well one channel was predicted after the burn; SI units.

    Attributes
    ----------
    name, unit : str
        The channel and its unit.
    samples : int
        Number of samples that were compared.
    rmse : float
        Root mean square of measured less predicted.
    nmse_percent : float
        Its square over the variance of the measured samples, in %.
    fit_percent : float
        100 (1 - ||error|| / ||measured - mean||).
    noise : float
        Standard deviation of the noise.
    expected : float
        RMSE that noise and the errors of initial states, coefficients and laws make, by root mean squares.
    limit : float
        RMSE that they exceed in one record of a thousand.
    one_step_rmse, one_step_expected : float
        The same for predictions one sample ahead.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> score = result.channels["x:m1"]
    >>> score.agrees, score.nmse_percent < 1.0
    (True, True)
    """

    name: str
    unit: str
    samples: int
    rmse: float
    nmse_percent: float
    fit_percent: float
    noise: float
    expected: float
    limit: float
    one_step_rmse: float
    one_step_expected: float

    @property
    def agrees(self) -> bool:
        """Whether the error is within its limit."""
        return self.rmse <= self.limit

    @property
    def is_vacuous(self) -> bool:
        """Whether an error as large as the motion would be within the limit."""
        return self.nmse_percent * self.limit**2 > 100.0 * self.rmse**2


@dataclass(frozen=True)
class CoefficientAgreement:
    """A coefficient of the answer beside its estimate from the record of the validation alone; SI units.

    Attributes
    ----------
    name, unit : str
        Full name and unit of the coefficient.
    value, standard_error : float
        The answer.
    record_value, record_error : float
        The estimate from this record, and its standard error.
    z : float
        Their difference in standard deviations of both errors together (Wald test).
    limit : float
        Absolute z that is exceeded by chance in one record of a thousand, by any of the coefficients.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.4, rate=1000.0).with_noise(40.0, seed=1)
    >>> other = lw.simulate(chain, release={"v:m1": 0.8}, duration=0.4, rate=1000.0).with_noise(40.0, seed=2)
    >>> fit = lw.identify(record, chain.unknown("nes"))
    >>> agreement = lw.validate(other, fit, refit=True).coefficients[0]
    >>> agreement.name, agreement.agrees
    ('nes1.alpha', True)
    """

    name: str
    unit: str
    value: float
    standard_error: float
    record_value: float
    record_error: float
    z: float
    limit: float

    @property
    def agrees(self) -> bool:
        """Whether the difference is within its limit."""
        return abs(self.z) <= self.limit


@dataclass(frozen=True, eq=False)
class ErrorProfile:
    """Where in the motion a prediction fails: the error in bins of a quantity.

    Attributes
    ----------
    quantity, unit : str
        What the bins are of, such as ``"time"`` or ``"d of nes1"``.
    edges : array of shape (b + 1,)
        Edges of the bins.
    error_percent : array of shape (b,)
        RMS over channels and samples of the error, each in % of the RMS of its channel about its mean; NaN in an empty bin.
    samples : array of int, shape (b,)
        Samples in the bins.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> profile = result.profiles[0]
    >>> profile.quantity, profile.unit, len(profile.edges) == len(profile.error_percent) + 1
    ('time', 's', True)
    """

    quantity: str
    unit: str
    edges: Floats
    error_percent: Floats
    samples: Floats

    @property
    def worst(self) -> tuple[float, float, float]:
        """Ends of the bin with the largest error, and that error in %."""
        worst = int(np.nanargmax(self.error_percent))
        return float(self.edges[worst]), float(self.edges[worst + 1]), float(self.error_percent[worst])


@dataclass(frozen=True, eq=False)
class ErrorSpectrum:
    """Power spectral densities of a channel: measured, and of the error of its prediction.

    Attributes
    ----------
    frequency : array of shape (f,)
        Frequency in Hz.
    measured, error : array of shape (f,)
        Densities in the square of the SI unit of the channel per Hz.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> spectrum = result.spectra["x:m1"]
    >>> spectrum.error.shape == spectrum.frequency.shape
    True
    >>> round(float(spectrum.frequency[-1]), 6)
    250.0
    """

    frequency: Floats
    measured: Floats
    error: Floats


@dataclass(frozen=True, eq=False, repr=False)
class Validation(JudgedView):
    """The result of `validate`: how well a structure predicts a record.

    Attributes
    ----------
    structure : Structure
        The structure, every coefficient a number.
    record : Record
        The record.
    predicted, deviation : Record
        The responses as the structure predicts them, missing where they are not scored, and the standard deviation that noise
        and the errors of initial states, coefficients and laws give the difference.
    channels : mapping of str to ChannelPrediction
        The scores by channel.
    burn : float
        Time in s at the start from which the state is estimated; it is not scored.
    window : float or None
        Time in s after which the run is started again, since chaos forbids a longer one; None for one free run.
    windows : int
        Number of runs.
    horizon : float or None
        Time in s after the burn at which the error of the initial state hides the motion; None if it does not.
    profiles : tuple of ErrorProfile
        The error over time, and over d and v of every link.
    spectra : mapping of str to ErrorSpectrum
        Spectra by channel.
    coefficients : tuple of CoefficientAgreement
        Whether the record agrees with each coefficient, estimated again from it alone; empty where none was.
    model_error : float
        Part of the forces that the laws are known to leave.
    remarks : tuple of str
        What else limits the comparison.
    refuted : bool
        Whether the laws of an answer without a model error leave more than noise of this record with any coefficients.
    basis : Basis
        The grade of the answer.
    refittable : tuple of Name
        The coefficients that a refit would estimate again from this record alone; empty after one, or without a covariance.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> result.trusted, result.free_run, sorted(result.channels)
    (True, True, ['x:m1', 'x:m2'])
    """

    structure: Structure
    record: Record
    predicted: Record
    deviation: Record
    channels: Mapping[str, ChannelPrediction]
    burn: float
    window: float | None
    windows: int
    horizon: float | None
    profiles: tuple[ErrorProfile, ...]
    spectra: Mapping[str, ErrorSpectrum]
    coefficients: tuple[CoefficientAgreement, ...] = ()
    model_error: float = 0.0
    remarks: tuple[str, ...] = field(default=())
    refuted: bool = False
    basis: Basis = UNGRADED
    refittable: tuple[Name, ...] = ()

    @property
    def free_run(self) -> bool:
        """Whether one free run predicts the record; else windows do."""
        return self.window is None

    @cached_property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the prediction agrees with the record: in every channel its RMSE is within its limit.

        It must have been able to disagree, in a channel or in coefficients that the record alone determines, or show the
        motion of a channel all the same.
        """
        channels = self.channels.values()
        if not all(channel.agrees for channel in channels):
            return (Verdict.PREDICTION_DISAGREES,)
        if self.refuted:
            return (Verdict.LAWS_REFUTED,)
        tested = self.coefficients or any(not c.is_vacuous or c.nmse_percent < _SHOWN for c in channels)
        return (Verdict.PREDICTION_AGREES if tested else Verdict.PREDICTION_NOT_TESTED,)

    @property
    def status(self) -> str:
        """The verdict in words."""
        return self.verdicts[0].status

    @cached_property
    def findings(self) -> tuple[str, ...]:
        """What is wrong with channels, channels and coefficients that disagree, where the error is largest, and remarks."""
        channels = [
            f"{entry.name}: the error is {entry.rmse:.3g} {entry.unit}; noise and intervals allow {entry.limit:.3g} "
            f"{entry.unit}."
            for entry in self.channels.values()
            if not entry.agrees
        ]
        coefficients = [
            f"{entry.name}: this record alone gives {entry.record_value:.6g}, {abs(entry.z):.1f} standard errors from "
            f"{entry.value:.6g} {entry.unit}."
            for entry in self.coefficients
            if not entry.agrees
        ]
        where = []
        if channels:
            for profile in self.profiles:
                low, high, percent = profile.worst
                where.append(
                    f"Over {profile.quantity} the error is largest from {low:.3g} to {high:.3g} {profile.unit}: "
                    f"{percent:.3g} % of the motion."
                )
        vacuous = [
            f"{entry.name}: the limit of {entry.limit:.3g} {entry.unit} exceeds its motion, so its agreement says nothing."
            for entry in self.channels.values()
            if entry.agrees and entry.is_vacuous
        ]
        return (*map(str, self.alerts), *channels, *vacuous, *coefficients, *where, *self.remarks)

    @cached_property
    def alerts(self) -> tuple[Alert, ...]:
        """What is wrong with channels of the record by themselves, worst first, as `inspect` reports it.

        Samples that were marked as missing are left out.
        """
        return unanswered_alerts((self.record,))

    def to_dict(self) -> dict[str, Any]:
        """The scores as plain data for JSON.

        Returns
        -------
        dict
            Channels, burn, windows, errors over the motion, coefficients, verdicts and findings.
        """
        return {
            "method": "validate",
            "status": self.status,
            "message": self.verdicts[0].value,
            "channels": {name: _entry_document(entry) for name, entry in self.channels.items()},
            "burn": self.burn,
            "free_run": self.free_run,
            "windows": {"count": self.windows, "length": self.window},
            "horizon": self.horizon,
            "where": {entry.quantity: _profile_document(entry) for entry in self.profiles},
            "refittable": list(self.refittable),
            "coefficients": {entry.name: _entry_document(entry) for entry in self.coefficients},
            "model_error_percent": 100.0 * self.model_error,
            **self._judgement(),
            "alerts": [alert.to_dict() for alert in self.alerts],
            "findings": list(self.findings),
        }

    def __str__(self) -> str:
        tables = (
            table([CHANNEL_HEAD, *channel_rows(self)]),
            table([COEFFICIENT_HEAD, *coefficient_rows(self)]),
        )
        return text_of(map(paragraph, headline(self)), *tables, map(remark_lines, self.findings))


def _profile_document(profile: ErrorProfile) -> dict[str, Any]:
    """A profile as plain data."""
    bins = {"edges": profile.edges, "error_percent": profile.error_percent, "samples": profile.samples}
    return {"unit": profile.unit, **{name: values.tolist() for name, values in bins.items()}}


def _entry_document(entry: ChannelPrediction | CoefficientAgreement) -> dict[str, Any]:
    """The fields but the name, and whether it agrees."""
    return {key: value for key, value in asdict(entry).items() if key != "name"} | {"agrees": entry.agrees}


CHANNEL_HEAD = ("channel", "RMSE", "allowed", "one step", "noise", "NMSE, %", "fit, %", "unit")
COEFFICIENT_HEAD = ("coefficient", "answer", "this record", "apart", "unit")


def headline(validation: Validation) -> tuple[str, ...]:
    """The verdict and what was run, in sentences."""
    record = validation.record
    scored = record.duration - validation.burn
    if validation.free_run:
        run = f"One free run of {scored:.4g} s"
    else:
        run = (
            f"The motion is chaotic: an error of the start, of the size of the noise, hides it after {validation.horizon:.3g} "
            f"s. {validation.windows} runs of {validation.window:.3g} s each"
        )
    burn = f"{run}, after {validation.burn:.4g} s that determine the state and are not scored."
    if not validation.refittable:
        return validation.verdicts[0].value, burn
    refit = f"a refit (--refit, refit=True) would free {listed(validation.refittable)}"
    return validation.verdicts[0].value, burn, f"Nothing was estimated again: {refit}."


def channel_rows(validation: Validation) -> list[tuple[str, ...]]:
    """A row for each channel."""
    return [
        (
            entry.name,
            f"{entry.rmse:.4g}",
            f"{entry.limit:.4g}",
            f"{entry.one_step_rmse:.4g}",
            f"{entry.noise:.4g}",
            f"{entry.nmse_percent:.3g}",
            f"{entry.fit_percent:.2f}",
            entry.unit,
        )
        for entry in validation.channels.values()
    ]


def coefficient_rows(validation: Validation) -> list[tuple[str, ...]]:
    """A row for each coefficient that the answer gives with an interval."""
    return [
        (
            entry.name,
            f"{format_value(entry.value, entry.standard_error)} ± {format_error(entry.standard_error)}",
            f"{format_value(entry.record_value, entry.record_error)} ± {format_error(entry.record_error)}",
            f"{entry.z:+.1f}",
            entry.unit,
        )
        for entry in validation.coefficients
    ]
