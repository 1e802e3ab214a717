"""What is validated: a structure, with what is known of the errors of its coefficients and laws."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path

from linkwise.argument_types import check_type
from linkwise.atomic import RESULT
from linkwise.errors import StructureError
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import COVARIANCE, Posterior, read_posterior
from linkwise.model.structure import Structure
from linkwise.model.toml_file import read_structure

_STRUCTURE = "structure.toml"


@dataclass(frozen=True, eq=False)
class ValidatedAnswer:
    """A structure of numbers, the distribution of its coefficients if known, its model error, and remarks on these."""

    structure: Structure
    posterior: Posterior | None = None
    model_error: float = 0.0
    remarks: tuple[str, ...] = ()

    @classmethod
    def of(cls, answer: Structure | Estimate | Posterior | str | Path) -> ValidatedAnswer:
        """What an answer in any of its forms says; StructureError where a coefficient has no value."""
        if isinstance(answer, str | Path):
            return _read(Path(answer))
        if isinstance(answer, Posterior):
            return cls(answer.structure, answer)
        if isinstance(answer, Estimate):
            if answer.trusted and answer.intervals:
                return cls(answer.structure, Posterior.of(answer), answer.model_error)
            why = answer.status if not answer.trusted else f"{answer.method} gives no intervals"
            return cls(answer.structure, None, answer.model_error if answer.trusted else 0.0, (_exact(why),))
        types = (Structure, Estimate, Posterior, str, Path)
        check_type("validate(record, answer)", "answer", answer, *types)
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
        return ValidatedAnswer(_numbers(read_structure(path), path))
    file = path / _STRUCTURE
    if not file.exists():
        raise StructureError(
            f"there is no {_STRUCTURE} in this folder: give a result folder of identify or discover, or a structure file",
            str(path),
        )
    model_error, status = _stated(path / RESULT)
    if (path / COVARIANCE).exists():
        return ValidatedAnswer(_numbers(read_structure(file), file), read_posterior(path), model_error)
    return ValidatedAnswer(_numbers(read_structure(file), file), None, model_error, (_exact(status),))


def _stated(path: Path) -> tuple[float, str]:
    """The model error that a trusted result states, and its status; of others the laws count as exact."""
    try:
        result = json.loads(path.read_text(encoding="utf-8"))
        status = str(result["status"])
        error = float(result.get("model_error_percent") or 0.0) / 100.0 if result.get("trusted") else 0.0
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return 0.0, f"no covariance is beside {_STRUCTURE}"
    return (error if math.isfinite(error) and error >= 0.0 else 0.0), status
