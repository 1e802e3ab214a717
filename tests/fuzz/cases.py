"""From a seed to an input."""

from collections.abc import Callable
from random import Random

from fuzz.case import Case, Kind
from fuzz.damage import damaged_text, hostile
from fuzz.options import option_case
from fuzz.record_files import record_case
from fuzz.text_files import answer_case, mapping_case, structure_case, study_case

_NAMES = ("d", "v", "k", "c", "alpha", "d0", "p", "x")
_FUNCTIONS = ("abs", "sign", "sqrt", "exp", "tanh", "sin", "cos", "log", "max", "min", "pow", "atan")
_NUMBERS = ("0", "1", "2", "3", "0.5", "1e-3", "1e6", "1e300", ".5", "10")


def law_case(seed: int, rng: Random) -> Case:
    """A law of chance: most can be read, some are hostile."""
    text = _expression(rng, rng.randrange(1, 5))
    if rng.random() < 0.4:
        text = damaged_text(rng, text)
    return Case(seed, "law", Kind.LAW, (text,))


def _expression(rng: Random, depth: int) -> str:
    if depth == 0 or rng.random() < 0.1:
        return rng.choice(_NUMBERS if rng.random() < 0.3 else _NAMES)
    left = _expression(rng, depth - 1)
    match rng.randrange(8):
        case 0 | 1:
            return f"{left} {rng.choice('+-')} {_expression(rng, depth - 1)}"
        case 2 | 3:
            return f"{left}*{_expression(rng, depth - 1)}"
        case 4:
            return f"({left})/({_expression(rng, depth - 1)})"
        case 5:
            return f"({left})**{rng.choice(('2', '3', '-1', '0.5', 'p', '17', '1e3'))}"
        case 6:
            function = rng.choice(_FUNCTIONS)
            second = f", {_expression(rng, depth - 1)}" if function in ("max", "min", "pow") else ""
            return f"{function}({left}{second})"
        case _:
            return f"-({left})" if rng.random() < 0.8 else f"{left} {hostile(rng)}"


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
