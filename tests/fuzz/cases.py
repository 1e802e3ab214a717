"""From a seed to an input."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from fuzz.answers import answer_case
from fuzz.case import Case
from fuzz.laws import law_case
from fuzz.mapping_files import mapping_case
from fuzz.options import option_case
from fuzz.record_files import record_case
from fuzz.structures import structure_case
from fuzz.study_files import study_case

_SHARES: dict[Callable[[int, Random], Case], float] = {
    law_case: 0.25,
    structure_case: 0.25,
    record_case: 0.15,
    mapping_case: 0.05,
    answer_case: 0.05,
    study_case: 0.10,
    option_case: 0.15,
}


def make_case(seed: int) -> Case:
    """The input of this seed, the same on every machine and whatever was made before."""
    rng = Random(seed)
    (make,) = rng.choices(tuple(_SHARES), weights=tuple(_SHARES.values()))
    return make(seed, rng)
