"""The functions of laws: one table says all that the package knows of each.

A function is added by one entry: the parser, evaluation, derivatives, antiderivatives, units, the places where a law is not
smooth and the integrator read it from here. Rules are texts in `x` (and `y` for the second argument) that may use the other
functions of the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import final

import numpy as np

from linkwise.registry import Registry


@final
@dataclass(frozen=True, kw_only=True)
class LawFunction:
    """A function that laws may call, of one argument `x`, or of two, `x` and `y`.

    A function of two arguments must be associative, commutative and idempotent, as max is: of more arguments it is nested.

    Parameters
    ----------
    value
        The NumPy ufunc that evaluates it; constants are folded with it too.
    derivatives
        The partial derivative by each argument, as texts; at a kink the mean of both sides.
    antiderivative
        An antiderivative by `x`, continuous wherever the function is finite; None where there is none in closed form.
    degree
        How the value scales with the argument, f(a x) = a**degree f(x) for a > 0: the value has the unit of the argument to
        this power. None for a function of a pure number.
    kink
        Zero where the function is not smooth, as a text; None where it is smooth everywhere. Then `branch` is the function on
        either side, with `s` the sign of the kink.
    flat
        Arguments beyond which the function or its derivatives are lost in rounding, so that a Taylor series taken there does
        not see what comes: an integration step has to end at them.
    integrator
        The name of the function in the integrator's library, where it differs from its own; not used if there is a kink.
    writable
        Whether a law may contain it; if not, only derivatives and antiderivatives do.
    """

    value: np.ufunc
    derivatives: tuple[str, ...]
    antiderivative: str | None = None
    degree: Fraction | None = None
    kink: str | None = None
    branch: str = ""
    flat: tuple[float, ...] = ()
    integrator: str = ""
    writable: bool = True

    @property
    def arity(self) -> int:
        """The number of arguments."""
        return len(self.derivatives)


_FLAT_TANH = 15.0  # up to which its slope, computed as 1 - tanh^2, still has digits; tanh is 1 - 2e-13 there
_FLAT_EXP = -40.0  # below which it is nothing beside rounding

FUNCTIONS: Registry[LawFunction] = Registry(
    "function of laws",
    {
        "abs": LawFunction(
            value=np.absolute,
            derivatives=("sign(x)",),
            antiderivative="0.5*x*abs(x)",
            degree=Fraction(1),
            kink="x",
            branch="s*x",
        ),
        "sign": LawFunction(
            value=np.sign,
            derivatives=("0",),
            antiderivative="abs(x)",
            degree=Fraction(0),
            kink="x",
            branch="s",
        ),
        "sqrt": LawFunction(
            value=np.sqrt,
            derivatives=("0.5/sqrt(x)",),
            antiderivative="2/3*x*sqrt(x)",
            degree=Fraction(1, 2),
        ),
        "exp": LawFunction(value=np.exp, derivatives=("exp(x)",), antiderivative="exp(x)", flat=(_FLAT_EXP,)),
        "tanh": LawFunction(
            value=np.tanh,
            derivatives=("1 - tanh(x)**2",),
            # log(cosh(x)) + log(2), written so that it neither overflows nor cancels far from 0
            antiderivative="abs(x) + log(1 + exp(-2*abs(x)))",
            flat=(_FLAT_TANH, -_FLAT_TANH),
        ),
        "sin": LawFunction(value=np.sin, derivatives=("cos(x)",), antiderivative="-cos(x)"),
        "cos": LawFunction(value=np.cos, derivatives=("-sin(x)",), antiderivative="sin(x)"),
        "max": LawFunction(
            value=np.maximum,
            derivatives=("0.5 + 0.5*sign(x - y)", "0.5 - 0.5*sign(x - y)"),
            degree=Fraction(1),
            kink="x - y",
            branch="(0.5 + 0.5*s)*x + (0.5 - 0.5*s)*y",
        ),
        "min": LawFunction(
            value=np.minimum,
            derivatives=("0.5 - 0.5*sign(x - y)", "0.5 + 0.5*sign(x - y)"),
            degree=Fraction(1),
            kink="x - y",
            branch="(0.5 - 0.5*s)*x + (0.5 + 0.5*s)*y",
        ),
        "log": LawFunction(value=np.log, derivatives=("1/x",), writable=False),
    },
)


def writable_functions() -> tuple[str, ...]:
    """The names of the functions that a law may contain."""
    return tuple(name for name, function in FUNCTIONS.items() if function.writable)
