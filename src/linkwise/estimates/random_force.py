"""A random force on a mass, as an estimate reports it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RandomForceEstimate:
    """A random force on a mass: an ambient one, or the noise of the channel of an applied force or of the base.

    Attributes
    ----------
    where : str
        The mass, or the channel.
    ambient : bool
        Whether it is an ambient force.
    deviation : float
        Standard deviation of samples of it at the rate of the first record, in its unit.
    spectral_density : float
        One-sided amplitude spectral density, in that unit over sqrt(Hz).
    found : bool
        Whether it was found; else it was stated.
    unit : str
        N of a force, N m of a moment, m or m/s^2 of a base.
    upper_limit : float or None
        Where the deviation was looked for and found to be zero, or not certainly above it: what it does not exceed, at 95 %;
        of an ambient force the spectral density. None for others.

    Examples
    --------
    >>> import linkwise as lw
    >>> force = lw.RandomForceEstimate("m1", True, deviation=2.0, spectral_density=0.4, found=True)
    >>> force.description
    'An ambient force on m1 of 0.4 N/sqrt(Hz), found with the other unknowns, is allowed for.'
    """

    where: str
    ambient: bool
    deviation: float
    spectral_density: float
    found: bool
    unit: str = "N"
    upper_limit: float | None = None

    @property
    def description(self) -> str:
        """In words, with its size."""
        if self.upper_limit is not None and self.deviation == 0.0:
            return self._absence(self.upper_limit)
        origin = "found with the other unknowns" if self.found else "as stated"
        unit, chance = (f"{self.unit}/sqrt(Hz)" if self.ambient else self.unit), ""
        if self.upper_limit is not None:
            chance = f"; it may be chance, and is below {self.upper_limit:.2g} {unit} (95 %)"
        if self.ambient:
            size = f"An ambient force on {self.where} of {self.spectral_density:.3g} {unit}"
        else:
            size = f"Noise of {self.where} of {self.deviation:.3g} {unit}"
        return f"{size}, {origin}, is allowed for{chance}."

    def _absence(self, limit: float) -> str:
        """That there is none, and the largest that there may be."""
        kind = "ambient force on" if self.ambient else "noise of"
        unit = f"{self.unit}/sqrt(Hz)" if self.ambient else self.unit
        return f"No {kind} {self.where} was found: it is below {limit:.2g} {unit} (95 %)."

    def to_dict(self) -> dict[str, str | float | bool | None]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "where": self.where,
            "kind": "ambient" if self.ambient else "input noise",
            "deviation": self.deviation,
            "deviation_unit": self.unit,
            "spectral_density": self.spectral_density,
            "spectral_density_unit": f"{self.unit}/sqrt(Hz)",
            "found": self.found,
            "upper_limit": self.upper_limit,
        }
