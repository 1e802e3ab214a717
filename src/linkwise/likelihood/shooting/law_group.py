"""Links with one law, and their states, by their places in the arrays of a system."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache
from types import EllipsisType

from linkwise.arrays import Floats
from linkwise.expression import Expression, Program, differentiate
from linkwise.model.law import VARIABLES, Law
from linkwise.model.slider_corners import smooth_rates


@dataclass(frozen=True)
class LawGroup:
    """Links with one law.

    Attributes
    ----------
    law : Law
        The law.
    links : slice
        Their positions on the link axis.
    first : int
        Position of their first coefficient in the vector of coefficients.
    first_state : int
        Position of their first state on the state axis: state by state, link by link.
    free : tuple of str
        Coefficients that are unknown in one of these links at least.
    lag : float or None
        Time in s by which a slider may lag behind its corner, which is rounded; None takes rates as they are written.
    """

    law: Law
    links: slice
    first: int
    first_state: int
    free: tuple[str, ...]
    lag: float | None = None

    @property
    def states(self) -> slice:
        """Positions of the states of these links."""
        return slice(self.first_state, self.first_state + len(self.law.states) * self.size)

    @property
    def size(self) -> int:
        """Number of links."""
        return int(self.links.stop - self.links.start)

    @cached_property
    def force(self) -> Program:
        """Program for the force and the rates of the states from d, v, the states and the coefficients."""
        return _force_program(self.law, self.lag)

    @cached_property
    def partials(self) -> Program:
        """Program for the partial derivatives of the force with respect to d, v, the unknown coefficients and the states, and
        then of each rate.
        """
        return _slope_program(self.law, self.free, self.lag)

    @cached_property
    def slopes(self) -> Program:
        """Program for the partial derivatives of the force with respect to d and v, from what `partials` takes."""
        return _slope_of_motion_program(self.law)

    @property
    def rows(self) -> slice:
        """Positions of the coefficients of these links in the vector of coefficients: name by name, link by link."""
        return slice(self.first, self.first + len(self.law.coefficients) * self.size)

    @cached_property
    def which(self) -> tuple[EllipsisType, slice, slice]:
        """Index of these links in arrays (..., L, K)."""
        return (..., self.links, slice(None))

    @cached_property
    def _which_states(self) -> tuple[tuple[EllipsisType, slice, slice], ...]:
        """Index of each state of the law in arrays (..., S, K)."""
        starts = range(self.first_state, self.states.stop, self.size)
        return tuple((..., slice(start, start + self.size), slice(None)) for start in starts)

    def of_states(self, values: Floats) -> list[Floats]:
        """The parts (..., m, K) of an array over all states (..., S, K), one for each state of the law."""
        return [values[which] for which in self._which_states]

    def row(self, name: str) -> slice:
        """Positions of one coefficient of these links.

        Parameters
        ----------
        name : str
            Name of the coefficient.

        Returns
        -------
        slice
            Its positions in the vector of coefficients.
        """
        start = self.first + self.law.coefficients.index(name) * self.size
        return slice(start, start + self.size)


@lru_cache(maxsize=512)
def _force_program(law: Law, lag: float | None) -> Program:
    trees = _trees(law, lag)
    return Program(trees, (*law.variables, *law.coefficients), wide=law.variables)


@lru_cache(maxsize=512)
def _slope_program(law: Law, free: tuple[str, ...], lag: float | None) -> Program:
    names = (*VARIABLES, *free, *law.states)
    trees = _trees(law, lag)
    slopes = [differentiate(tree, name) for tree in trees for name in names]
    return Program(slopes, (*law.variables, *law.coefficients), wide=law.variables)


@lru_cache(maxsize=512)
def _slope_of_motion_program(law: Law) -> Program:
    slopes = [differentiate(law.expression, name) for name in VARIABLES]
    return Program(slopes, (*law.variables, *law.coefficients), wide=law.variables)


def _trees(law: Law, lag: float | None) -> list[Expression]:
    """The force of a law and the rates of its states."""
    rates = [rate.expression for rate in law.rates] if lag is None else smooth_rates(law, lag)
    return [law.expression, *rates]
