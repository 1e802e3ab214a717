"""What is validated: a structure, with what is known of the errors of its coefficients and laws."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from linkwise.errors import StructureError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.sensor_error import SensorErrorEstimate
from linkwise.estimates.stated_trust import not_trusted, untrusted_remark
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, read_posterior
from linkwise.model.structure import Structure
from linkwise.model.toml_file import read_structure
from linkwise.output import RESULT

_STRUCTURE = "structure.toml"


@dataclass(frozen=True, eq=False)
class ValidatedAnswer:
    """A structure of numbers, with what is known of the errors of its coefficients, its laws and the sensors.

    That is the distribution of the coefficients if known, the model error, errors of sensors, and remarks on these; and a
    warning where the answer is not to be trusted.
    """

    structure: Structure
    posterior: Posterior | None = None
    model_error: float = 0.0
    remarks: tuple[str, ...] = ()
    sensor_errors: tuple[SensorErrorEstimate, ...] = ()
    warning: str = ""

    @classmethod
    def of(cls, answer: Structure | Estimate | Posterior | str | Path) -> ValidatedAnswer:
        """What an answer in any of its forms says; StructureError where a coefficient has no value."""
        if isinstance(answer, str | Path):
            return _read(Path(answer))
        if isinstance(answer, Posterior):
            return cls(answer.structure, answer)
        if isinstance(answer, Estimate):
            error = answer.model_error if answer.trusted else 0.0
            if answer.trusted and answer.intervals:
                return cls(answer.structure, Posterior.of(answer), error, (), answer.sensor_errors)
            why = answer.status if not answer.trusted else f"{answer.method} gives no intervals"
            warning = "" if answer.trusted else not_trusted(why)
            return cls(answer.structure, None, error, (_exact(why),), answer.sensor_errors, warning)
        return cls(_numbers(answer))


def _exact(why: str) -> str:
    return (
        f"The coefficients are taken as exact, since the answer does not say how far they may be off ({why})."
    )


def _numbers(structure: Structure, file: str | Path = "") -> Structure:
    for parameter in structure.parameters:
        raise StructureError(
            f"{parameter.name} is unknown, and every coefficient must be a number here: identify it first, or give one",
            str(file),
        )
    return structure


def _read(path: Path) -> ValidatedAnswer:
    """A result folder of identify or discover, or a structure file."""
    if not path.is_dir():
        return ValidatedAnswer(_numbers(read_structure(path), path), warning=untrusted_remark(path))
    file = path / _STRUCTURE
    if not file.exists():
        raise StructureError(
            f"there is no {_STRUCTURE} in this folder: give a result folder of identify or discover, or a structure file",
            str(path),
        )
    stated = _ResultFile.of(path / RESULT)
    structure = _numbers(read_structure(file), file)
    if (path / COVARIANCE).exists():
        return ValidatedAnswer(structure, read_posterior(path), stated.model_error, (), stated.sensor_errors)
    return ValidatedAnswer(
        structure, None, stated.model_error, (_exact(stated.status),), stated.sensor_errors, stated.warning
    )


@dataclass(frozen=True)
class _ResultFile:
    """What a result file states: its status, the model error of one that is trusted, errors of sensors, and a warning."""

    status: str
    model_error: float = 0.0
    sensor_errors: tuple[SensorErrorEstimate, ...] = ()
    warning: str = ""

    @classmethod
    def of(cls, path: Path) -> _ResultFile:
        """What the file states; nothing where it cannot be read, so that the laws and sensors count as exact."""
        try:
            result = json.loads(path.read_text(encoding="utf-8"))
            status = str(result["status"])
            error = float(result.get("model_error_percent") or 0.0) / 100.0 if result.get("trusted") else 0.0
            of_sensors = tuple(map(SensorErrorEstimate.from_dict, result.get("sensor_errors", ())))
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            return cls(f"no covariance is beside {_STRUCTURE}")
        warning = "" if result.get("trusted") else not_trusted(status)
        return cls(status, error if math.isfinite(error) and error >= 0.0 else 0.0, of_sensors, warning)
