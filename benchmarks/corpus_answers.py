"""What the corpus keeps of an answer: plain data of verdicts, values with standard errors, numbers without, and causes."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from functools import singledispatch
from typing import Any

import numpy as np

import linkwise as lw

CAUSES = 6  # the first ones are kept; what follows explains hardly anything
DIGITS = 10

Answer = dict[str, Any]


def number(value: float | None) -> float | None:
    """A number as it is stored; None where there is none, or none that is finite."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.{DIGITS}g}")


def numbers(values: Mapping[str, float | None]) -> dict[str, float | None]:
    return {name: number(value) for name, value in values.items()}


def judged(answer: Any) -> Answer:
    """Verdicts and trust, which every answer has."""
    return {
        "trusted": bool(answer.trusted),
        "verdicts": [verdict.name.lower() for verdict in answer.verdicts],
    }


def refusal(error: Exception) -> Answer:
    """The kind of an error and the first line of its message."""
    return {"refused": type(error).__name__, "message": str(error).partition("\n")[0]}


@singledispatch
def answer_of(answer: Any) -> Answer:
    """What is kept of an answer of any kind; of several answers by name, those of each."""
    raise TypeError(f"the corpus keeps nothing of a {type(answer).__name__}")


@answer_of.register
def _(estimate: lw.Estimate) -> Answer:
    errors = np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0))
    values = {
        parameter.name: [number(value), number(error) if free else None]
        for parameter, value, error, free in zip(
            estimate.parameters, estimate.values.tolist(), errors.tolist(), estimate.free, strict=True
        )
    }
    for error in estimate.sensor_errors:
        values[f"{error.kind} of {error.channel}"] = [number(error.value), number(error.standard_error)]
    return {
        "method": estimate.method,
        "status": estimate.status,
        **judged(estimate),
        "numbers": numbers(
            {
                "chi-square": estimate.chi_square_per_sample,
                "model error": estimate.model_error,
                **{f"noise of {name}": noise.sigma for name, noise in estimate.noise.items()},
                **{f"random force {force.where}": force.deviation for force in estimate.random_forces},
            }
        ),
        "values": values,
        "causes": causes(estimate.diagnosis),
    }


def causes(diagnosis: Iterable[lw.estimates.Cause]) -> list[list[Any]]:
    return [
        [cause.kind, cause.where, cause.term or cause.source, number(cause.size)]
        for cause in list(diagnosis)[:CAUSES]
    ]


@answer_of.register
def _(discovery: lw.Discovery) -> Answer:
    kept = sorted(discovery.kept, key=lambda term: term.name)
    return {
        **answer_of(discovery.estimate),
        **judged(discovery),
        "terms": [f"{term.name} {term.term} {term.decision.value}" for term in kept],
        "memory": [f"{law.link} {law.law}" for law in discovery.memory if law.kept],
    }


@answer_of.register
def _(host: lw.modal.HostEstimate) -> Answer:
    values: dict[str, list[float | None]] = {}
    for name, mode in zip(host.host.coordinates, host.host.modes, strict=True):
        for what, coefficient in (("frequency", mode.frequency), ("damping", mode.damping)):
            values[f"{name}.{what}"] = [number(coefficient.value), number(coefficient.sigma)]
        for point, size in mode.shape.items():
            values[f"{name}.{point}"] = [number(size), number(mode.shape_sigma.get(point))]
    return {
        **judged(host),
        "faint": list(host.faint),
        "numbers": numbers({"chi-square": host.chi_square_per_sample}),
        "values": values,
    }


@answer_of.register
def _(validation: lw.Validation) -> Answer:
    channels = validation.channels.values()
    errors = {f"rmse of {channel.name}": channel.rmse for channel in channels}
    limits = {f"limit of {channel.name}": channel.limit for channel in channels}
    return {
        **judged(validation),
        "disagrees": [channel.name for channel in channels if not channel.agrees]
        + [entry.name for entry in validation.coefficients if not entry.agrees],
        "numbers": numbers({**errors, **limits, "burn": validation.burn, "window": validation.window}),
        "values": {
            entry.name: [number(entry.record_value), number(entry.record_error)]
            for entry in validation.coefficients
        },
    }


@answer_of.register
def _(limit: lw.analysis.Limit) -> Answer:
    return {
        **judged(limit),
        "numbers": numbers(
            {
                f"standard error of {parameter.name}": error
                for parameter, error in zip(limit.parameters, limit.standard_errors.tolist(), strict=True)
            }
            | {f"detectable force of {link.name}": link.force_error for link in limit.links}
        ),
    }


@answer_of.register
def _(absorption: lw.Absorption) -> Answer:
    decays = {
        f"{what} of {mass.name} {run}": getattr(decay, attribute)
        for mass in absorption.masses
        for run, decay in (("with", mass.with_sinks), ("without", mass.without))
        for what, attribute in (
            ("peak", "peak"),
            ("rms", "rms"),
            ("settled", "settled"),
            ("rate", "decay_rate"),
        )
    }
    shares = {f"share of {sink.sink.link}": sink.share for sink in absorption.sinks}
    harvests = {f"harvest of {harvest.link}": harvest.energy for harvest in absorption.harvests}
    return {**judged(absorption), "numbers": numbers({**decays, **shares, **harvests})}


@answer_of.register
def _(intervals: lw.absorption.AbsorptionIntervals) -> Answer:
    return {
        **judged(intervals),
        "numbers": numbers(
            {
                f"{what} of {interval.quantity.name}": getattr(interval, what)
                for interval in intervals.quantities
                for what in ("value", "lower", "upper")
            }
        ),
    }


@answer_of.register
def _(inspection: lw.inspection.Inspection) -> Answer:
    return {
        **judged(inspection),
        "alerts": [f"{alert.kind} {alert.channel}" for alert in inspection.alerts],
        "numbers": numbers({f"noise of {channel.name}": channel.noise for channel in inspection.channels}),
    }
