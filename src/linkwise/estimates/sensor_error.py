"""An error of a sensor that was found with the coefficients, as an estimate reports it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any, Literal, TypeAlias, get_args

ErrorKind: TypeAlias = Literal["offset", "gain", "delay"]


@dataclass(frozen=True)
class SensorErrorEstimate:
    """A constant error of a sensor, its gain or its delay, found with the coefficients.

    Attributes
    ----------
    channel : str
        The channel.
    kind : {"offset", "gain", "delay"}
        What it is: the sensor shows ``gain * motion(t - delay) + offset``, and the channel of a force that of a force.
    value, standard_error : float
        Its size and the standard error of that: of an offset in the SI unit of the channel, of a delay in s.
    unit : str
        That unit; 1 of a gain.

    Examples
    --------
    >>> import linkwise as lw
    >>> error = lw.SensorErrorEstimate("x:m1", "gain", value=1.02, standard_error=0.001, unit="1")
    >>> error.description
    'x:m1 shows 1.02 of its motion (estimated with the other unknowns, standard error 0.001).'
    """

    channel: str
    kind: ErrorKind
    value: float
    standard_error: float
    unit: str

    @property
    def description(self) -> str:
        """In words, with its standard error."""
        size = {
            "offset": f"is off by {self.value:.4g} {self.unit.replace('?', '')}".rstrip() + " throughout",
            "gain": f"shows {self.value:.6g} of its {self._shown}",
            "delay": f"is late by {1e3 * self.value:.4g} ms",
        }[self.kind]
        error = (
            f"{1e3 * self.standard_error:.2g} ms" if self.kind == "delay" else f"{self.standard_error:.2g}"
        )
        return f"{self.channel} {size} (estimated with the other unknowns, standard error {error})."

    @property
    def _shown(self) -> str:
        """What the channel shows."""
        return {"force": "force", "f": "force", "state": "value"}.get(
            self.channel.partition(":")[0], "motion"
        )

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> SensorErrorEstimate:
        """Read what `to_dict` wrote.

        Parameters
        ----------
        document : mapping of str to object
            Its part of result.json.

        Returns
        -------
        SensorErrorEstimate
            The error.

        Raises
        ------
        KeyError, TypeError, ValueError
            If something is missing, of another type, or not finite.
        """
        kind, value, error = document["kind"], float(document["value"]), float(document["standard_error"])
        if kind not in get_args(ErrorKind) or not (isfinite(value) and isfinite(error) and error >= 0.0):
            raise ValueError(f"not an error of a sensor: {dict(document)}")
        return cls(str(document["channel"]), kind, value, error, str(document["unit"]))

    def to_dict(self) -> dict[str, str | float]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "channel": self.channel,
            "kind": self.kind,
            "value": self.value,
            "standard_error": self.standard_error,
            "unit": self.unit,
        }
