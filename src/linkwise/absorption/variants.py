"""Trials of one question about structures that differ in a few numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from linkwise.absorption.comparison import Comparison
from linkwise.model.structure import Structure


class Variants:
    """Trials of one question about structures that differ in the parameters `names`, made of a structure with harvesters.

    The structure without sinks is built anew only where a parameter is found in it.
    """

    def __init__(self, equipped: Structure, trial: Comparison, names: Sequence[str]) -> None:
        self.equipped, self.trial = equipped, trial
        self.same_bare = not any(_touches_bare(trial, equipped, name) for name in names)

    def at(self, values: Mapping[str, float]) -> Comparison:
        """The trial with these values of the parameters."""
        numbers = {name: value for name, value in values.items() if ":" not in name}
        release = {name: value for name, value in values.items() if ":" in name}
        excitation = self.trial.options.excitation
        if release:
            excitation = replace(excitation, release={**excitation.release, **release})
        structure = self.equipped.with_values(numbers) if numbers else self.trial.structure
        return self.trial.varied(structure, excitation, self.trial.baseline if self.same_bare else None)


def _touches_bare(trial: Comparison, equipped: Structure, name: str) -> bool:
    """Whether a parameter may change the structure without sinks."""
    if ":" in name or any(each.same_as for link in equipped.links for each in link.coefficients.values()):
        return True
    if any(mass.mass.same_as for mass in equipped.masses):
        return True
    owner = name.rpartition(".")[0]
    left = trial.baseline.structure
    if owner in {link.name for link in equipped.links}:
        return owner in {link.name for link in left.links}
    return trial.options.without != "removed" or owner in left.mass_names
