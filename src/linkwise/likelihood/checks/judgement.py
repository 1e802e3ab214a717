"""The judgement on a fit, and what its checks look at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from inspect import getdoc
from types import MappingProxyType
from typing import Literal

import numpy as np

from linkwise.arrays import Floats
from linkwise.display import format_percent
from linkwise.estimates.causes import SLIP, WINDOW, Cause
from linkwise.likelihood.checks.horizons import CloserFit, held_closer
from linkwise.likelihood.checks.jumps import Jump, likeliest_jump
from linkwise.likelihood.checks.unstated_forces import unstated_forces
from linkwise.likelihood.fit import LikelihoodFit
from linkwise.likelihood.harmonics import Lines
from linkwise.likelihood.noise import lag_one_autocorrelation
from linkwise.likelihood.random_forces import noise_of_channels
from linkwise.likelihood.shooting.minimise import AnnealingSchedule
from linkwise.likelihood.tests.diagnosis import AS_LIKELY, Diagnosis, diagnose, likeliest_first
from linkwise.likelihood.tests.variances import SPECTRAL_KINDS, InputNoise, noise_of_inputs
from linkwise.model.coefficient import MASS
from linkwise.model.structure import Structure
from linkwise.records.channel import Channel
from linkwise.records.record import Record
from linkwise.verdict import Grade, Verdict

LARGEST_SHIFT = 3.0
"""Standard errors: the largest change of a coefficient that leaves an answer as it is, by an error of a sensor or an input, by
a mass, or by a term beside noise of inputs."""
LARGEST_TERM = 0.05
"""Relative to the force in a link: with a larger missing term in the law, the coefficients would change by more than an
engineer can neglect."""
LIKELIER = 16.0
"""Of -2 log likelihood: what a likelier cause gains more than another where chance gives that to one in 3000 (Vuong 1989)."""
_SHOWN = 1.2  # times the noise that a channel shows: stated noise below it is no error of the laws
_STATED = frozenset({MASS, "gain", "force gain"})
"""Causes by which the records contradict a stated mass or calibration, where they move a coefficient."""
_CONTRADICTED = frozenset(
    {"sign", "unit", "swapped", "place", "relative", "high pass", "clipped", SLIP, WINDOW}
)
"""The same of a sign, a unit, a place, a window or a sequence of samples, which no small size makes harmless."""
_LEAVES_NOISE = (Verdict.SEVERAL_OPTIMA, Verdict.HARDLY_DETERMINED, Verdict.COVARIANCE_NOT_POSITIVE)
"""Verdicts on laws that leave only noise."""
_NOTHING = 1.0
"""Of the forces on a mass: laws that leave more in the mean square are no better than none, which leave all of it."""
_CHANCE = 3.0  # standard deviations of chi-square within which missing terms of many links are not looked for
AS_NOISE = 0.25
"""Of what the likeliest term explains: noise of an input that explains less is that term, seen as noise. Of 166 records with
such noise alone, five had a term before it in the diagnosis, which explained 1.1 to 2.1 times as much. The same of a line."""
_LINE = 3.0
"""Times what noise of an input or an ambient force explains: a line behind a resonance that explains less is its part."""
_FEW_LINKS = 4  # whose missing terms cost little to look for: then wherever chi-square is above 1


@dataclass(frozen=True)
class Judgement:
    """What the checks of a fit say of it.

    Attributes
    ----------
    verdict, message : Verdict, str
        The verdict, with its explanation.
    model_error : float
        The part of the forces that the laws leave unexplained.
    diagnosis : tuple of Cause
        What would explain what is left, the largest gain in likelihood first.
    added : mapping of str to array of shape (p, p)
        What intervals hold beside the covariance of the fit, by what makes them wider: "terms", "masses", "sensors", "events",
        "blocks", "input noise" or "skewed profiles".
    is_final : bool
        Whether no later check has a say.
    """

    verdict: Verdict
    message: str
    model_error: float = 0.0
    diagnosis: tuple[Cause, ...] = ()
    added: Mapping[str, Floats] = field(default_factory=dict)
    is_final: bool = False

    @property
    def lacks_more(self) -> bool:
        """Whether laws or inputs lack, or may lack, what profiles of the likelihood do not allow for."""
        lacking = self.verdict is Verdict.MODEL_ERROR_NEEDED and bool(self.diagnosis)
        return lacking or any(what != SKEWED for what in self.added)

    @property
    def added_for_terms(self) -> Floats | None:
        """(p, p) what intervals hold of missing terms, and of masses and sensors that are off; None of nothing."""
        parts = [self.added[what] for what in ("terms", "masses", "sensors") if what in self.added]
        return np.sum(parts, axis=0) if parts else None

    @property
    def may_be_approximate(self) -> bool:
        """Whether the scatter between parts of the records gives intervals: not where what was stated is contradicted, or
        the laws explain nothing of a mass.
        """
        contradicted = self.verdict is Verdict.MEASUREMENT_ERROR and any(
            map(_contradicts, self.diagnosis[:1])
        )
        return self.verdict.grade is Grade.APPROXIMATE and not contradicted and self.model_error < _NOTHING

    @property
    def leaves_noise(self) -> bool:
        """Whether the laws leave only noise, in which nothing is significant."""
        return self.verdict is Verdict.CONVERGED and not self.diagnosis

    def saying(self, remark: str, added: Mapping[str, Floats] = MappingProxyType({})) -> Judgement:
        """The same with a remark, and with what intervals hold beside."""
        return replace(self, message=f"{self.message} {remark}", added={**self.added, **added})

    def overruled(self, verdict: Verdict, message: str, *causes: Cause, is_final: bool = False) -> Judgement:
        """Another verdict, for causes that come before those found so far."""
        diagnosis = (*causes, *self.diagnosis)
        return Judgement(verdict, message, self.model_error, diagnosis, is_final=is_final)


SKEWED = "skewed profiles"


def _rivals(cause: Cause, line: Cause) -> bool:
    """Whether a cause that moves coefficients is as likely as a line, which moves them little."""
    return cause.shift > LARGEST_SHIFT and likeliest_first(cause) < likeliest_first(line) + AS_LIKELY


def _contradicts(cause: Cause) -> bool:
    """Whether a cause contradicts what was stated, by more than coefficients hold."""
    return cause.kind in _CONTRADICTED or (cause.kind in _STATED and not cause.shift <= LARGEST_SHIFT)


@dataclass(frozen=True, eq=False)
class Examined:
    """A fit that is judged, and what more than one check asks of it.

    Attributes
    ----------
    fit : LikelihoodFit
        The fit.
    structures : sequence of Structure
        The structures with their unknowns: that of the fit, after a search that of all that was offered before it.
    records : sequence of Record
        The records.
    searched : bool
        Whether the laws were searched in the records, or stated.
    """

    fit: LikelihoodFit
    structures: Sequence[Structure]
    records: Sequence[Record]
    searched: bool = False

    @cached_property
    def identified(self) -> Structure:
        """The structure with the values of the fit."""
        return self.structures[-1].with_values(self.fit.by_name)

    @property
    def channels(self) -> Sequence[Channel]:
        """The channels of the records."""
        return self.records[0].channels

    @cached_property
    def diagnosis(self) -> Diagnosis:
        """What is significant in the residuals, and all that was tested."""
        beside = self.lines.columns if self.lines else None
        return diagnose(
            self.fit, self.identified, self.channels, terms=self._may_lack_any_term, beside=beside
        )

    @cached_property
    def lines(self) -> Lines | None:
        """Lines in what the fit leaves; None without any."""
        return Lines.of(self.fit, self.identified, self.records)

    @cached_property
    def inputs(self) -> tuple[InputNoise, ...]:
        """Noise of the inputs, as the residuals show it."""
        return noise_of_inputs(self.fit, self.identified, self.channels)

    @cached_property
    def levels_of_inputs(self) -> dict[str, float]:
        """Standard deviations of the noise of the inputs, as the records state or show them."""
        return noise_of_channels(self.records, self.identified)

    def _is_allowed_for(self, noise: InputNoise) -> bool:
        """Whether noise of a signal in a law was stated, and is no larger."""
        is_stated = noise.channel.startswith("signal:") and noise.channel in self.records[0].noise
        return is_stated and noise.score.deviation <= _SHOWN * self.levels_of_inputs.get(noise.channel, 0.0)

    @cached_property
    def causes(self) -> tuple[Cause, ...]:
        """All that would explain what is left, the likeliest first; what spectra of forces show comes last."""
        noisy = [
            noise.cause
            for noise in self.inputs
            if noise.cause is not None and not self._is_allowed_for(noise)
        ]
        forces = unstated_forces(self.fit, self.identified, self.channels)
        random = max((cause.gain for cause in (*noisy, *forces)), default=0.0)
        first = max((cause.gain for cause in self.diagnosis.causes), default=0.0)
        least = max(_LINE * random, AS_NOISE * first)
        found = self.lines.causes(self.diagnosis.tested) if self.lines else ()
        lines = [
            replace(line, rivals=tuple(one.name for one in self.diagnosis.causes if _rivals(one, line)))
            for line in found
            if line.gain > least
        ]
        every = [*self.diagnosis.causes, *noisy, *forces, *lines]
        tells = bool(every) and not (noisy or self.fit.chi_square_off)
        if tells and self.jump is not None and self.jump.is_significant:
            every += [self.jump.event] * (self.jump.of_one > max(cause.gain for cause in every))
        return tuple(sorted(every, key=lambda cause: (cause.kind in SPECTRAL_KINDS, likeliest_first(cause))))

    @cached_property
    def jump(self) -> Jump | None:
        """The likeliest moment at which the motion of exact laws begins anew; None where chance gives as much."""
        return likeliest_jump(self.fit, self.identified, self.records, self.diagnosis.tested)

    @cached_property
    def closer(self) -> CloserFit | None:
        """The fit with its motion held closer to the laws; None beside noise of inputs that channels show to be there."""
        shown, forces = self.levels_of_inputs, self.fit.random_forces
        if forces and all(force.deviation <= _SHOWN * shown.get(force.where, 0.0) for force in forces):
            return None
        return held_closer(self.fit, self.identified, self.channels)

    @cached_property
    def share(self) -> float:
        """Root mean square of the force error over that of the forces, of the mass with the largest ratio."""
        if self.fit.model_error == 0.0:
            return 0.0
        masses = self.identified.size
        acceleration = self.fit.misfit.trajectories.accelerations.reshape(-1, masses, self.fit.segments.count)
        forces = self.identified.mass_values * np.sqrt(np.mean(acceleration**2, axis=(0, 2)))
        return float(np.max(self.fit.force_error / np.maximum(forces, np.finfo(float).tiny)))

    @property
    def is_settled(self) -> bool:
        """Whether the search converged to values with standard errors, which the residuals say something of."""
        return self.fit.converged and self.fit.has_errors

    def is_unexplained(self, verdict: Verdict) -> bool:
        """Whether the laws leave more than noise by a `verdict`, and the answer is not to be trusted."""
        settled = self.fit.model_error > 0.0 or self.fit.chi_square_off
        unsettled = verdict is Verdict.NOT_CONVERGED and not settled
        return verdict.forbids and not unsettled and verdict not in _LEAVES_NOISE

    @property
    def has_intervals_by_blocks(self) -> bool:
        """Whether intervals hold the scatter between blocks of the records, beside a model error."""
        return self.fit.model_error > 0.0 and self.fit.error_ratios is not None

    @property
    def coloured(self) -> list[Channel]:
        """The channels with noise that is correlated from sample to sample."""
        noise = self.fit.optimum.coloured
        return [] if noise is None else [self.records[0].responses[number] for number in noise.channels]

    @property
    def is_filtered(self) -> bool:
        """Whether all sensors have such noise, as a low-pass filter gives it."""
        all_are = 1 < len(self.records[0].responses) == len(self.coloured)
        return all_are and lag_one_autocorrelation(self.fit.misfit) > 0.0

    @property
    def explained(self) -> str:
        """How far the laws explain the records, in words."""
        if self.share >= _NOTHING:
            times = f"{self.share:.3g} times as large as all of them"
            return f"The structure explains none of the forces on a mass: what it leaves is {times}"
        if self.fit.model_error > 0.0:
            return f"The structure explains the record to within {format_percent(self.share)} of its forces"
        laws = "The laws and the random forces explain" if self.fit.random_forces else "The laws explain"
        coloured = ", ".join(self.coloured)
        noise = f", which is correlated from sample to sample in {coloured}" if coloured else ""
        return f"{laws} the record to within its noise{noise}"

    def found(self, verdict: Verdict, text: str, *first: Cause) -> Judgement:
        """A verdict with its text behind how far the laws explain the records, for causes that come `first`."""
        return Judgement(verdict, f"{self.explained}{text}", self.share, (*first, *self.causes))

    @property
    def _may_lack_any_term(self) -> bool:
        """Whether the laws leave enough for all terms to be tested, not only the usual ones."""
        fit, links = self.fit, len(self.identified.links) - len(self.identified.modes)
        chance = 0.0 if links <= _FEW_LINKS else _CHANCE
        return (
            bool(fit.random_forces)
            or fit.optimum.coloured is not None
            or max(fit.model_error, fit.optimum.q)
            > AnnealingSchedule.final_q  # laws lacking much fit then too
            or fit.chi_square > 1.0 + chance * np.sqrt(2.0 / fit.samples)
        )


@dataclass(frozen=True)
class Check:
    """One check of a fit.

    Attributes
    ----------
    name : str
        Its name.
    does : {"refuses", "approximates", "widens", "names"}
        What it does where it finds something: it gives the answer no intervals, or those of the closest laws of that form,
        makes intervals wider, or names a cause.
    judge : callable
        The judgement on what was `Examined`, and on the judgement before it where it is not to find the verdict; None where
        it finds nothing. Its docstring begins with what it asks.
    """

    name: str
    does: Literal["refuses", "approximates", "widens", "names"]
    judge: Callable[..., Judgement | None]

    @property
    def asks(self) -> str:
        """What it asks, in a sentence."""
        return " ".join((getdoc(self.judge) or "").partition("\n\n")[0].split())
