"""Comparisons of structures that differ in a few numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from linkwise.absorption.comparison import Comparison
from linkwise.model.parameters import is_shape
from linkwise.model.structure import Structure


@dataclass(frozen=True, eq=False)
class Variants:
    """Comparisons like `comparison` of structures that differ from `structure`, harvesters included, in some parameters.

    With `same_baseline` none of the parameters is part of the structure without sinks, which is then built once.
    """

    structure: Structure
    comparison: Comparison
    same_baseline: bool

    @classmethod
    def of(cls, structure: Structure, comparison: Comparison, names: Sequence[str]) -> Variants:
        """Variants in the parameters `names`: coefficients, masses and releases."""
        changes = any(_changes_baseline(comparison, structure, name) for name in names)
        return cls(structure, comparison, not changes)

    def at(self, values: Mapping[str, float]) -> Comparison:
        """The comparison with these values of the parameters."""
        numbers = {name: value for name, value in values.items() if ":" not in name}
        release = {name: value for name, value in values.items() if ":" in name}
        excitation = self.comparison.options.excitation
        if release:
            excitation = replace(excitation, release={**excitation.release, **release})
        structure = self.structure.with_values(numbers) if numbers else self.comparison.structure
        baseline = self.comparison.baseline if self.same_baseline else None
        return self.comparison.of_variant(structure, excitation, baseline)


def _changes_baseline(comparison: Comparison, structure: Structure, name: str) -> bool:
    """Whether a parameter may change the structure without sinks."""
    if (
        ":" in name
        or is_shape(name)
        or any(coefficient.same_as for link in structure.links for coefficient in link.coefficients.values())
    ):
        return True
    if any(mass.mass.same_as for mass in structure.masses):
        return True
    owner = name.rpartition(".")[0]
    baseline = comparison.baseline.structure
    if owner in {link.name for link in structure.links}:
        return owner in {link.name for link in baseline.links}
    return comparison.options.without != "removed" or owner in baseline.mass_names
