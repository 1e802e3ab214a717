"""Partial derivatives of the rates of states of links with memory."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.shooting.law_group import LawGroup


@dataclass(frozen=True, eq=False)
class RatePartials:
    """Partial derivatives of the rates of states, and of the forces by states; states are the last axis but one.

    Attributes
    ----------
    force : array of shape (..., S, K)
        Of the force of a state's link with respect to the state.
    by_d, by_v : array of shape (..., S, K)
        Of the rates with respect to elongation and rate of the link.
    by_state : tuple of (int, int, array)
        Of the rate of a state (first) with respect to a state (second), (..., K).
    by_parameter : tuple of (int, int, array)
        Of the rate of a state (first) with respect to a parameter (second), (..., K).
    """

    force: Floats
    by_d: Floats
    by_v: Floats
    by_state: tuple[tuple[int, int, Floats], ...]
    by_parameter: tuple[tuple[int, int, Floats], ...]


class MemorySlopes:
    """Collects the derivatives of the rates, group by group."""

    def __init__(self, parameter_map: Floats, states: Floats) -> None:
        self.parameter_map = parameter_map
        self.force, self.by_d, self.by_v = (np.empty_like(states) for _ in range(3))
        self.by_state: list[tuple[int, int, Floats]] = []
        self.by_parameter: list[tuple[int, int, Floats]] = []

    def take(self, group: LawGroup, slopes: list[Floats]) -> None:
        """Take in what `LawGroup.partials` gives behind the derivatives of the force by coefficients."""
        count, size, first = len(group.law.states), group.size, group.first_state
        for own, slope in zip(group.of_states(self.force), slopes[:count], strict=True):
            own[...] = slope
        width = 2 + len(group.free) + count
        for number in range(count):
            by_d, by_v, *others = slopes[count + number * width : count + (number + 1) * width]
            group.of_states(self.by_d)[number][...] = by_d
            group.of_states(self.by_v)[number][...] = by_v
            for offset in range(size):
                state = first + number * size + offset
                for source in range(count):
                    slope = others[len(group.free) + source][..., offset, :]
                    self.by_state.append((state, first + source * size + offset, slope))
                for name, slope in zip(group.free, others, strict=False):
                    factors = self.parameter_map[group.row(name).start + offset]
                    for column in np.flatnonzero(factors):
                        self.by_parameter.append(
                            (state, int(column), factors[column] * slope[..., offset, :])
                        )

    def partials(self) -> RatePartials:
        """All of them."""
        return RatePartials(self.force, self.by_d, self.by_v, tuple(self.by_state), tuple(self.by_parameter))
