"""Expressions compiled to a tape of NumPy operations, and their numerical integrals."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache, partial, reduce
from math import prod
from typing import Any, final

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats, sign_changes
from linkwise.expression.tree import (
    FUNCTIONS,
    Call,
    Expression,
    Number,
    Power,
    Product,
    Sum,
    Symbol,
    as_expression,
    multiply,
)

_OPERATORS: dict[str, np.ufunc] = {
    "+": np.add, "-": np.subtract, "*": np.multiply, "/": np.divide, "negative": np.negative, "**": np.power,
}  # fmt: skip
_LARGEST_PRODUCT = 64  # integer powers up to this are products
_ARITHMETIC = (np.add, np.subtract, np.multiply, np.divide)  # rounded alike, however operands are stored
_STRETCHED = 4096  # numbers in an array up to which to broadcast takes longer than the arithmetic

Operation = Callable[[], object]
"""A step of an evaluation, from arrays into arrays."""


@final
class Program:
    """Several expressions evaluated together, every sub-expression once.

    `Program(outputs, inputs)(*arrays)` takes one array (or number) per name of `inputs`, broadcasts them against each other
    and returns a tuple of float64 arrays of the broadcast shape, one per output. The arrays are read-only and may share
    memory with each other and with the inputs. No warning is issued where a result is not finite.

    `wide` names the inputs that are large arrays (by default all): what depends only on the others is computed first, at
    their smaller size. Raises ValueError for a name that is not an input.
    """

    __slots__ = ("_large", "_narrow", "_outputs", "_slots", "_tape", "inputs")

    def __init__(
        self, outputs: Sequence[Expression], inputs: Sequence[str], *, wide: Sequence[str] | None = None
    ) -> None:
        self.inputs = tuple(inputs)
        numbering = _ValueNumbering(self.inputs, frozenset(inputs if wide is None else wide))
        values = [numbering.write(output) for output in outputs]
        self._slots, self._tape, self._outputs = _allocate(numbering, values)
        known = [number for number, value in enumerate(self._slots, len(self.inputs)) if value is not None]
        narrow = [number for number in range(len(self.inputs)) if not numbering.wide[number]]
        self._narrow = frozenset([*narrow, *known, *(to for *_, to, wide in self._tape if not wide)])
        written = {to for *_, to, is_wide in self._tape if is_wide}
        self._large = tuple(dict.fromkeys(index for index in self._outputs if index in written))

    def __call__(self, *arrays: ArrayLike) -> tuple[Floats, ...]:
        if len(arrays) != len(self.inputs):
            message = f"expected {len(self.inputs)} arrays ({', '.join(self.inputs)}), got {len(arrays)}"
            raise ValueError(message)
        slots: list[Any] = [np.asarray(array, dtype=np.float64) for array in arrays]
        shape = _common_shape(*[array.shape for array in slots])
        slots += self._slots
        # one allocation: page faults cost more than the arithmetic
        block = np.empty((len(self._large), *shape))
        for row, index in enumerate(self._large):
            slots[index] = block[row, ...]
        with np.errstate(all="ignore"):
            for ufunc, first, second, to, wide in self._tape:
                target = (np.empty(shape) if slots[to] is None else slots[to]) if wide else None
                if second < 0:
                    slots[to] = ufunc(slots[first], out=target)
                else:
                    slots[to] = ufunc(slots[first], slots[second], out=target)
        for index in self._large:
            slots[index].flags.writeable = False
        outputs = ((slots[index], index in self._large) for index in self._outputs)
        return tuple(array if large else np.broadcast_to(array, shape) for array, large in outputs)

    def into(self, arrays: Sequence[Floats], out: Sequence[Floats]) -> list[Operation]:
        """The operations that evaluate the program again and again, to be called in this order where floating-point
        warnings are ignored: on what `arrays` hold by then, into `out`. One array per name of `inputs`: those that are not
        `wide` are read now, the others whenever the operations are done. One per output in `out`, of the broadcast shape
        of `arrays`, overwritten; none shares memory with an input or with another.
        """
        slots: list[Any] = [*arrays, *self._slots]
        copied = []
        for index, target in zip(self._outputs, out, strict=True):
            if index in self._large and slots[index] is None:
                slots[index] = target
            else:
                copied.append((index, target))
        operations: list[Operation] = []
        shape = out[0].shape
        with np.errstate(all="ignore"):
            for ufunc, first, second, to, wide in self._tape:
                numbers = (first,) if second < 0 else (first, second)
                operands = [slots[number] for number in numbers]
                if not wide:
                    slots[to] = ufunc(*operands)
                    continue
                slots[to] = np.empty(shape) if slots[to] is None else slots[to]
                if ufunc not in _ARITHMETIC:
                    operations.append(partial(ufunc, *operands, out=slots[to]))
                    continue
                stretched = (
                    _stretched(operand, shape) if number in self._narrow else operand
                    for number, operand in zip(numbers, operands, strict=True)
                )
                operations.append(partial(ufunc, *stretched, slots[to]))  # sooner read than `out=`
        return operations + [partial(np.copyto, target, slots[index]) for index, target in copied]


cached_program = lru_cache(maxsize=2048)(Program)


def _stretched(operand: ArrayLike, shape: tuple[int, ...]) -> Floats:
    """An operand such that an operation with one of `shape` need not broadcast it, where that takes the longest."""
    array = np.asarray(operand, dtype=np.float64)
    if array.size == 1:
        return array.reshape(())
    if array.shape == shape or prod(shape) > _STRETCHED:
        return array
    stretched = np.empty(shape)
    stretched[...] = array
    return stretched


@lru_cache(maxsize=1024)
def _common_shape(*shapes: tuple[int, ...]) -> tuple[int, ...]:
    return np.broadcast_shapes(*shapes)


_Value = str | float | tuple[Any, ...]  # an input's name, a constant, or (operation, operands)


class _ValueNumbering:
    """Gives every distinct value one number, operands before results."""

    def __init__(self, inputs: tuple[str, ...], wide: frozenset[str]) -> None:
        self.inputs = inputs
        self.values: list[_Value] = list(inputs)
        self.index: dict[_Value, int] = {name: number for number, name in enumerate(inputs)}
        self.wide: list[bool] = [name in wide for name in inputs]

    def number(self, value: _Value, wide: bool) -> int:
        if value not in self.index:
            self.index[value] = len(self.values)
            self.values.append(value)
            self.wide.append(wide)
        return self.index[value]

    def apply(self, operation: str, *operands: int) -> int:
        if operation in ("+", "*") or (len(operands) == 2 and operation in FUNCTIONS):
            operands = tuple(sorted(operands))
        return self.number((operation, *operands), any(self.wide[operand] for operand in operands))

    def fold(self, operation: str, operands: list[int]) -> int:
        """The operation over all operands, the narrow ones among themselves first."""
        narrow = [operand for operand in operands if not self.wide[operand]]
        wide = [operand for operand in operands if self.wide[operand]]
        parts = [reduce(lambda a, b: self.apply(operation, a, b), part) for part in (wide, narrow) if part]
        return parts[0] if len(parts) == 1 else self.apply(operation, *parts)

    def write(self, expression: Expression) -> int:
        match expression:
            case Number(value):
                return self.number(value, False)
            case Symbol(name):
                if name not in self.index:
                    raise ValueError(f"{name!r} is not among the inputs {', '.join(map(str, self.values))}")
                return self.index[name]
            case Sum(parts):
                return self.sum(parts)
            case Product(factors):
                return self.product(factors)
            case Power(_, int() as exponent) if -_LARGEST_PRODUCT <= exponent < 0:
                return self.product((expression,))
            case Power(base, int() as exponent) if 0 <= exponent <= _LARGEST_PRODUCT:
                return self.integer_power(self.write(base), exponent)
            case Power(base, exponent):
                return self.apply("**", self.write(base), self.write(as_expression(exponent)))
            case Call(function, arguments):
                return self.apply(function, *(self.write(argument) for argument in arguments))
        raise TypeError(f"not an expression: {expression!r}")

    def integer_power(self, base: int, exponent: int) -> int:
        if exponent == 1:
            return base
        if exponent % 2:
            return self.apply("*", self.integer_power(base, exponent - 1), base)
        half = self.integer_power(base, exponent // 2)
        return self.apply("*", half, half)

    def sum(self, parts: tuple[Expression, ...]) -> int:
        plus, minus = [], []
        for part in parts:
            match part:
                case Number(value) if value < 0:
                    minus.append(self.number(-value, False))
                case Product((Number(value), *rest)) if value < 0:
                    minus.append(self.write(multiply(Number(-value), *rest)))
                case _:
                    plus.append(self.write(part))
        if not plus:
            return self.apply("negative", self.fold("+", minus))
        total = self.fold("+", plus)
        return self.apply("-", total, self.fold("+", minus)) if minus else total

    def product(self, factors: tuple[Expression, ...]) -> int:
        over, under, negative = [], [], False
        for factor in factors:
            match factor:
                case Number(-1.0):
                    negative = True
                case Power(base, int() as exponent) if -_LARGEST_PRODUCT <= exponent < 0:
                    under.append(self.integer_power(self.write(base), -exponent))
                case _:
                    over.append(self.write(factor))
        if not over:
            over, negative = [self.number(-1.0 if negative else 1.0, False)], False
        result = self.fold("*", over)
        if under:
            result = self.apply("/", result, self.fold("*", under))
        return self.apply("negative", result) if negative else result


def _allocate(
    numbering: _ValueNumbering, outputs: list[int]
) -> tuple[list[Any], list[tuple[np.ufunc, int, int, int, bool]], list[int]]:
    """Constants, the tape and the slots of the outputs, with few slots.

    A slot is reused for a value of its kind (wide or narrow) from the operation on that reads it last; elementwise, that
    operation may write to it too. Slots of outputs are not reused.
    """
    values, inputs = numbering.values, len(numbering.inputs)
    last: dict[int, float] = {}
    for number, value in enumerate(values):
        if isinstance(value, tuple):
            last.update(dict.fromkeys(value[1:], number))
    last.update(dict.fromkeys(outputs, float("inf")))
    constants = [number for number, value in enumerate(values) if isinstance(value, float)]
    slot = {number: number for number in range(inputs)} | {n: inputs + i for i, n in enumerate(constants)}
    slots: list[Any] = [values[number] for number in constants]
    free: dict[bool, list[int]] = {True: [], False: []}
    tape = []
    for number, value in enumerate(values):
        if not isinstance(value, tuple):
            continue
        operation, *operands = value
        first, second = slot[operands[0]], slot[operands[1]] if len(operands) > 1 else -1
        for operand in set(operands):
            if last[operand] == number and isinstance(values[operand], tuple):
                free[numbering.wide[operand]].append(slot[operand])
        wide = numbering.wide[number]
        if free[wide] and last[number] != float("inf"):
            to = free[wide].pop()
        else:
            to = inputs + len(slots)
            slots.append(None)
        ufunc = _OPERATORS[operation] if operation in _OPERATORS else FUNCTIONS[operation].value
        tape.append((ufunc, first, second, to, wide))
        slot[number] = to
    return slots, tape, [slot[number] for number in outputs]


_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(10)
# over the whole range; with 10 nodes a panel, exact to rounding for all but the steepest integrands
_PANELS = 128
_BLOCK = 65536  # panels evaluated at once, which bounds the memory


def integral_from_zero(program: Program, upper: ArrayLike, parameters: Sequence[ArrayLike]) -> Floats:
    """The integral of the program's first output over its first input, from 0 to each of `upper`.

    The program's other outputs are the kinks of the first: their zeros become panel borders. `parameters` are its other
    inputs; all arrays broadcast. Composite Gauss-Legendre quadrature, order 20 between kinks; NaN where `upper`
    is not finite.
    """
    columns = np.broadcast_arrays(*(np.asarray(array, dtype=np.float64) for array in (upper, *parameters)))
    ends = columns[0].ravel()
    result = np.full(ends.shape, np.nan)
    if all(np.size(value) == 1 for value in parameters):
        sets = np.array([[float(np.ravel(value)[0]) for value in parameters]])
        which = np.zeros(ends.shape, dtype=np.intp)
    else:
        rows = np.stack([column.ravel() for column in columns[1:]], axis=1)
        sets, which = np.unique(rows, axis=0, return_inverse=True)
    for index, values in enumerate(sets):
        chosen = (which.ravel() == index) & np.isfinite(ends)
        if chosen.any():
            result[chosen] = _from_zero(program, ends[chosen], values)
    return result.reshape(columns[0].shape)


def _from_zero(program: Program, upper: Floats, parameters: Floats) -> Floats:
    low, high = min(0.0, float(upper.min())), max(0.0, float(upper.max()))
    grid = np.linspace(low, high, _PANELS + 1)
    borders = np.unique(np.concatenate([grid, upper, [0.0], _zeros(program, grid, parameters)]))
    total = np.zeros(borders.size)
    for first in range(0, borders.size - 1, _BLOCK):
        ends = borders[first : first + _BLOCK + 1]
        half = 0.5 * np.diff(ends)[:, None]
        points = ends[:-1, None] + half * (1.0 + _NODES)
        total[first + 1 : first + ends.size] = (program(points, *parameters)[0] * half) @ _WEIGHTS
    np.cumsum(total, out=total)
    return np.asarray(total[np.searchsorted(borders, upper)] - total[np.searchsorted(borders, 0.0)])


def _zeros(program: Program, grid: Floats, parameters: Floats) -> Floats:
    """Zeros of the kinks between points of the grid."""

    def kink(number: int) -> Callable[[Floats], Floats]:
        return lambda d: program(d, *parameters)[number]

    numbers = range(1, len(program(0.0, *parameters)))
    return np.concatenate([np.empty(0), *(sign_changes(kink(number), grid) for number in numbers)])
