"""Modes of hosts: frequency, damping, and the shape at the points of the host."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from linkwise.argument_types import checked_class
from linkwise.errors import StructureError
from linkwise.model.coefficient import Coefficient, as_coefficient
from linkwise.model.names import index_of


@checked_class
@dataclass(frozen=True)
class HostMode:
    """A mode of a host.

    Parameters
    ----------
    frequency : Coefficient or float
        Natural frequency in Hz; 0 for a rigid motion. A number is known.
    damping : Coefficient or float
        Damping as a part of the critical one.
    shape : mapping of str to float
        Mass-normalised shape at every point of the host, in 1/sqrt(kg); in rad/(m sqrt(kg)) where the point turns.
    shape_sigma : mapping of str to float, optional
        Standard deviations to which the shape is known, by point: Gaussian priors about `shape`, infinite where it is only a
        start. At points that are not named it is known exactly.
    rotations : set of str, optional
        The points whose displacement is a rotation in rad, and not in m.

    Raises
    ------
    StructureError
        If the frequency or the damping is negative, or the shape not finite.

    Examples
    --------
    >>> import linkwise as lw
    >>> mode = lw.HostMode(5.2, 0.01, {"tip": 1.0, "joint": 0.62})
    >>> mode.shape["joint"]
    0.62
    """

    frequency: Coefficient
    damping: Coefficient
    shape: Mapping[str, float] = field(hash=False)
    shape_sigma: Mapping[str, float] = field(hash=False)
    rotations: frozenset[str]

    def __init__(
        self,
        frequency: Coefficient | float,
        damping: Coefficient | float,
        shape: Mapping[str, float],
        shape_sigma: Mapping[str, float] = MappingProxyType({}),
        rotations: Collection[str] = (),
    ) -> None:
        vars(self).update(
            frequency=as_coefficient(frequency, "the frequency of a mode"),
            damping=as_coefficient(damping, "the damping of a mode"),
            shape=shape,
            shape_sigma=shape_sigma,
            rotations=frozenset(rotations),
        )
        if self.frequency.value is not None and not self.frequency.value >= 0.0:
            raise StructureError(
                f"the frequency of a mode must not be negative, got {self.frequency.value!r} Hz"
            )
        if self.damping.value is not None and not self.damping.value >= 0.0:
            raise StructureError(f"the damping of a mode must not be negative, got {self.damping.value!r}")
        for point, value in self.shape.items():
            if not math.isfinite(value):
                raise StructureError(
                    f'the shape of a mode at the point "{point}" must be a finite number, got {value!r}'
                )
        for point, sigma in self.shape_sigma.items():
            if point not in self.shape or not sigma > 0.0:
                raise StructureError(
                    f'the standard deviation of the shape at "{point}" must be positive, and its point one of the shape, '
                    f"got {sigma!r}"
                )
        for point in self.rotations:
            index_of(self.shape, point, "point", "points")
        for name in ("shape", "shape_sigma"):
            numbers = {point: float(value) for point, value in getattr(self, name).items()}
            object.__setattr__(self, name, MappingProxyType(numbers))

    def __reduce__(self) -> tuple[type[HostMode], tuple[object, ...]]:
        shape, sigma = dict(self.shape), dict(self.shape_sigma)
        return HostMode, (self.frequency, self.damping, shape, sigma, self.rotations)

    def shape_value(self, point: str) -> Coefficient:
        """The shape at a point, known or known to within.

        Parameters
        ----------
        point : str
            Its name in the host.

        Returns
        -------
        Coefficient
            The shape in 1/sqrt(kg), or in rad/(m sqrt(kg)).

        Raises
        ------
        StructureError
            If there is no such point.
        """
        value, sigma = index_of(self.shape, point, "point", "points"), self.shape_sigma.get(point)
        return Coefficient.number(value) if sigma is None else Coefficient.unknown(value, sigma=sigma)

    def with_shape(self, changes: Mapping[str, Coefficient]) -> HostMode:
        """The mode with other shapes at some points.

        Parameters
        ----------
        changes : mapping of str to Coefficient
            The shape by point; an unknown without a start keeps the present value as one.

        Returns
        -------
        HostMode
            The mode.
        """
        shape, sigma = dict(self.shape), dict(self.shape_sigma)
        for point, change in changes.items():
            shape[point] = shape[point] if change.value is None else change.value
            sigma.pop(point, None)
            if not change.known:
                sigma[point] = change.sigma
        return replace(self, shape=shape, shape_sigma=sigma)
