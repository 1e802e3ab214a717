"""What was tested of a fit: hypotheses of what it may lack, and the equations at its optimum with a column for each."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from linkwise.arrays import Floats
from linkwise.likelihood.block_scores import BlockScores
from linkwise.likelihood.fit import Optimum
from linkwise.likelihood.hypotheses import Hypothesis
from linkwise.likelihood.shooting.block_information import FactoredModel, block_information
from linkwise.likelihood.shooting.residuals import Misfit
from linkwise.likelihood.shooting.sensor_errors import SensorErrors
from linkwise.likelihood.single_tests import SingleTests, single_tests


@dataclass(frozen=True, eq=False)
class TestedCauses:
    """What may explain what a fit leaves, and the equations at its optimum with a column for each.

    `curvature`, `slope` and `scatter` are in the p scaled parameters and, after them, in the sizes of the `hypotheses`, of
    which `units` (h,) are in their own; `filtered` is the column of a filter that all channels share. `model` is that of the
    optimum alone, in the segments of `longer`, by which blocks of the records scatter; None where not found beside these.
    """

    __test__ = False  # no test of pytest

    hypotheses: tuple[Hypothesis, ...]
    units: Floats
    curvature: Floats
    slope: Floats
    scatter: Floats
    errors: SensorErrors
    filtered: SensorErrors
    model: FactoredModel | None
    longer: tuple[Optimum, Misfit]

    @cached_property
    def block_scores(self) -> BlockScores | None:
        """Those of the optimum; None where its model is not in blocks, or its equations are singular."""
        if self.model is None or not self.model.in_blocks:
            return None
        of_blocks = block_information(self.model, self.longer[0].q)
        return None if of_blocks is None else BlockScores(*of_blocks)

    @cached_property
    @np.errstate(
        over="ignore", invalid="ignore"
    )  # a candidate may be infinite somewhere; it is then not tested
    def tests(self) -> SingleTests:
        """Of each hypothesis alone."""
        return single_tests(self.curvature, self.slope, self.scatter, len(self.slope) - len(self.hypotheses))
