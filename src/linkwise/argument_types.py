"""The types of arguments of public functions: what has another type, or is swapped, is reported at once.

`checked` reads what a function takes from its annotations. Numbers are those of NumPy, too; whether a number, a name or a
shape makes sense is for the function to say.
"""

from __future__ import annotations

import inspect
import os
import sys
import types
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence, Sized
from functools import cached_property, lru_cache, wraps
from itertools import chain, repeat
from numbers import Integral, Real
from pathlib import Path
from typing import (
    Any,
    Literal,
    ParamSpec,
    TypeVar,
    Union,
    cast,
    get_args,
    get_origin,
    get_type_hints,
    is_typeddict,
)

from linkwise.display import near_miss, shortened
from linkwise.errors import ArgumentTypeError

P = ParamSpec("P")
R = TypeVar("R")
Class = TypeVar("Class", bound=type)

_MAKERS = {  # of texts
    "Record": "read_record(path) reads one from a file",
    "Structure": "read_structure(path) reads one from a file",
    "Law": "Law.parse(text) makes one of a text",
    "Coefficient": "Coefficient.unknown() makes one to be identified",
}
CHECKED_INSIDE = object()
"""Marks a type, as in ``Annotated[..., CHECKED_INSIDE]``, that the function itself checks, whose message says more."""
_PLAIN = (float, int, bool, str, type(None))
_FEW = 16  # entries: more than any sequence of a fixed length has
_CONTAINERS = (Sequence, Iterable, Collection, tuple, list)


class _Array:
    """Stands for an array of numbers in annotations, whatever its type is called there."""

    def __class_getitem__(cls, item: object) -> type:
        return cls


_ARRAYS = {"ArrayLike": _Array, "NDArray": _Array, "Floats": _Array, "Bools": _Array, "Indices": _Array}


def check_type(argument: str, value: object, *kinds: Any) -> None:
    """Raise `ArgumentTypeError` unless the value is of one of the types; `argument` says whose it is."""
    if not any(_fits(value, kind) for kind in kinds):
        names = list(dict.fromkeys(_name(kind) for kind in kinds))
        expected = " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
        raise ArgumentTypeError(f"{argument} must be of type {expected}, got {_given(value, names)}")


def checked(function: Callable[P, R]) -> Callable[P, R]:
    """A function that refuses arguments of other types than it is annotated with.

    Parameters
    ----------
    function : callable
        A function or a method.

    Returns
    -------
    callable
        The same function; it raises `ArgumentTypeError` with the name of the argument and what was expected.

    Examples
    --------
    >>> @checked
    ... def period(rate: float) -> float:
    ...     return 1.0 / rate
    >>> period("4.0")
    Traceback (most recent call last):
    linkwise.errors.ArgumentTypeError: period(rate): rate must be of type float, got '4.0'; write it without quotes
    """
    takes = _Takes(function)

    @wraps(function)
    def at_the_door(*args: P.args, **kwargs: P.kwargs) -> R:
        takes.check(args, kwargs)
        return function(*args, **kwargs)

    return at_the_door


def checked_class(owner: Class) -> Class:
    """A class whose constructor and public methods are checked as functions are, before they run; see `checked`."""
    for name, member in tuple(vars(owner).items()):
        function = getattr(member, "__func__", member)
        if isinstance(function, types.FunctionType) and (name == "__init__" or not name.startswith("_")):
            wrapped: Any = checked(function)
            setattr(owner, name, wrapped if function is member else type(member)(wrapped))
    return owner


class _Takes:
    """What a function takes, read from its annotations when it is first called."""

    def __init__(self, function: Callable[..., object]) -> None:
        self.function = function
        self._accepted: set[tuple[str, object]] = set()  # parameters with forms of values; see `_form`

    @cached_property
    def _parameters(self) -> Mapping[str, inspect.Parameter]:
        return inspect.signature(self.function).parameters

    @cached_property
    def _annotations(self) -> dict[str, Any]:
        """The annotation of each parameter, and of each of the keywords that a TypedDict lists."""
        function: Any = inspect.unwrap(self.function)
        namespace = {**function.__globals__, **_ARRAYS}
        annotations = inspect.get_annotations(function, globals=namespace, eval_str=True)
        collected = [annotations.pop(name) for name in self._named(inspect.Parameter.VAR_KEYWORD)]
        for kind in (listed for unpacked in collected for listed in get_args(unpacked)):
            annotations |= get_type_hints(kind, localns=_ARRAYS, include_extras=True)
        annotations.pop("return", None)
        return annotations

    @cached_property
    def _kinds(self) -> dict[str, tuple[Any, ...]]:
        """The types that each of them may have, but for those that the function checks."""
        return {
            name: tuple(_alternatives(kind))
            for name, kind in self._annotations.items()
            if CHECKED_INSIDE not in getattr(kind, "__metadata__", ())
        }

    def _named(self, *kinds: object) -> list[str]:
        """The names of the parameters of some kinds."""
        return [name for name, parameter in self._parameters.items() if parameter.kind in kinds]

    @cached_property
    def _order(self) -> list[str]:
        """The parameters that may be given by place."""
        return self._named(inspect.Parameter.POSITIONAL_OR_KEYWORD)

    @cached_property
    def _rest(self) -> list[str]:
        """The parameter that takes the other arguments by place, if there is one."""
        return self._named(inspect.Parameter.VAR_POSITIONAL)

    @cached_property
    def _known(self) -> frozenset[str]:
        """All keywords that the function takes."""
        return frozenset((*self._parameters, *self._annotations))

    @cached_property
    def _needed(self) -> list[str]:
        """The arguments that the function needs, by place or by name."""
        return [
            name
            for name, parameter in self._parameters.items()
            if parameter.default is parameter.empty
            and parameter.kind in (parameter.POSITIONAL_OR_KEYWORD, parameter.KEYWORD_ONLY)
        ]

    @cached_property
    def _call(self) -> str:
        """The function and the arguments that it needs by place, as in "identify(record, structure)"."""
        needed = [name for name in self._needed if name in self._order and name not in ("self", "cls")]
        return f"{self._name}({', '.join(needed)})"

    @cached_property
    def _name(self) -> str:
        return self.function.__qualname__.removesuffix(".__init__")

    @cached_property
    def _exact(self) -> dict[str, frozenset[type]]:
        """Types of which a value needs no further look, by parameter."""
        return {name: frozenset(chain(*map(_exact, kinds))) for name, kinds in self._kinds.items()}

    def check(self, args: tuple[object, ...], kwargs: Mapping[str, object]) -> None:
        """Raise `ArgumentTypeError` for the first argument that is unknown, missing, or of another type."""
        if kwargs or len(args) < len(self._needed):
            self._check_names(self._order[: len(args)], kwargs)
        exact = self._exact
        try:
            for name, value in zip(chain(self._order, *map(repeat, self._rest)), args, strict=False):
                if name in exact and type(value) not in exact[name]:
                    self._check_value(name, value)
            for name, value in kwargs.items():
                if name in exact and type(value) not in exact[name]:
                    self._check_value(name, value)
        except ArgumentTypeError as error:
            raise ArgumentTypeError(f"{self._where(args, kwargs)}: {error}") from None

    def _check_value(self, name: str, value: object) -> None:
        """Check a value, unless one of its form was of the type that the parameter has."""
        form = _form(value)
        if (name, form) not in self._accepted:
            _check(name, value, self._kinds[name])
            if form is not None:
                self._accepted.add((name, form))

    def _where(self, args: tuple[object, ...], kwargs: Mapping[str, object]) -> str:
        """What is called; of what is built, its name, as in 'link "nes1"'."""
        named = {**dict(zip(self._order, args, strict=False)), **kwargs}.get("name")
        built = self.function.__name__ == "__init__" and isinstance(named, str)
        return f'{self._name.lower()} "{named}"' if built else self._call

    def _check_names(self, by_place: Sequence[str], by_keyword: Mapping[str, object]) -> None:
        for name in by_keyword:
            if name not in self._known:
                hint = near_miss(name, self._known)
                raise ArgumentTypeError(f"{self._name}() got an unexpected keyword argument {name!r}{hint}")
        for name in self._needed:
            if name not in by_place and name not in by_keyword:
                raise ArgumentTypeError(f"{self._call}: {name} is missing")


def _check(name: str, value: object, kinds: tuple[Any, ...]) -> None:
    """Raise `ArgumentTypeError` unless a value is of one of the types, and so is what it holds."""
    check_type(name, value, *kinds)
    for kind in kinds:
        for part, content, inside in _parts(name, value, kind):
            _check(part, content, tuple(_alternatives(inside)))


def _form(value: object) -> object:
    """All on which the check of a value depends, where that is short to say: its type and those of what it holds."""
    kind = type(value)
    if kind in _PLAIN:
        return kind
    if _is_array(value):
        array: Any = value
        listed = array.ndim == 1 and array.size <= _FEW  # a sequence of a fixed length may be asked for
        return (kind, array.dtype.kind, array.ndim) if array.dtype.kind in "biuf" and not listed else None
    if kind is dict:
        mapping = cast(dict[object, object], value)
        forms = frozenset(map(_form, mapping.values()))
        return (kind, frozenset(map(type, mapping)), forms) if None not in forms else None
    return None


def _alternatives(kind: Any) -> Iterator[Any]:
    """The members of a union, and of unions within it."""
    if get_origin(kind) in (Union, types.UnionType):
        for member in get_args(kind):
            yield from _alternatives(member)
    else:
        yield kind


@lru_cache(maxsize=1024)
def _exact(kind: Any) -> frozenset[type]:
    """Types whose values are of a type, parts included; none for containers, whose parts are looked at."""
    if get_origin(kind) in (Union, types.UnionType):
        return frozenset(chain(*map(_exact, _alternatives(kind))))
    origin = get_origin(kind) or kind
    if origin is float:
        return frozenset((float, int))
    if origin is Literal:
        return frozenset(type(choice) for choice in get_args(kind))
    if origin is None:
        return frozenset((type(None),))
    looked_at = (*_CONTAINERS, Mapping, dict, _Array, Callable)
    return frozenset((origin,)) if isinstance(origin, type) and origin not in looked_at else frozenset()


def _fits(value: object, kind: Any) -> bool:
    """Whether a value is of a type, its parts left aside."""
    origin = get_origin(kind) or kind
    if kind is Any:
        return True
    if origin in (float, int):
        number: Any = value
        number = number[()] if _is_array(value) and number.ndim == 0 else value
        return isinstance(number, Real if origin is float else Integral) and not isinstance(number, bool)
    if origin is bool:
        return isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")
    if origin is Literal:
        return any(isinstance(value, type(choice)) for choice in get_args(kind))
    if origin in (None, type(None)):
        return value is None
    if origin is _Array:
        return _numeric(value)
    if origin is Path:
        return isinstance(value, os.PathLike)
    if origin in _CONTAINERS:  # a text would be taken letter by letter
        flat = not _is_array(value) or getattr(value, "ndim", 1) == 1
        return flat and isinstance(value, Iterable) and not isinstance(value, str | bytes | Mapping)
    if origin is Callable or (getattr(origin, "_is_protocol", False) and "__call__" in vars(origin)):
        return callable(value)
    if is_typeddict(origin):
        return isinstance(value, Mapping)
    return isinstance(value, origin) if isinstance(origin, type) else True


def _is_array(value: object) -> bool:
    """Whether a value is an array of NumPy, which commands that need none do not load."""
    numpy = sys.modules.get("numpy")
    return numpy is not None and isinstance(value, numpy.ndarray)


def _is_listed(value: object) -> bool:
    """Whether what a value holds can be looked at more than once."""
    return isinstance(value, tuple | list) or _is_array(value)


def _numeric(value: object) -> bool:
    """Whether NumPy reads a value as an array of real numbers."""
    numpy = sys.modules.get("numpy")
    if numpy is None or value is None or isinstance(value, str | bytes | Mapping):
        return False
    try:
        array = numpy.asarray(value)
        return array.dtype.kind in "biuf" or (array.dtype.kind == "O" and bool(array.astype(float).size + 1))
    except (TypeError, ValueError):
        return False


def _parts(argument: str, value: object, kind: Any) -> Iterator[tuple[str, object, Any]]:
    """What a container of the type `kind` holds, each with its name and the type that it should have."""
    origin, inside = get_origin(kind), get_args(kind)
    if isinstance(value, Mapping) and origin in (Mapping, dict):
        keys, contents = map(_exact, inside)
        for key, content in value.items():
            if type(key) not in keys:
                yield f"a key of {argument}", key, inside[0]
            if type(content) not in contents:
                yield f"{argument}[{key!r}]", content, inside[1]
    elif isinstance(value, Sized) and _is_listed(value) and origin in _CONTAINERS and inside:
        fixed = origin is tuple and inside[-1] is not Ellipsis
        if fixed and len(value) != len(inside):
            raise ArgumentTypeError(f"{argument} must have {len(inside)} entries, got {len(value)}")
        for number, content in enumerate(cast(Sequence[object], value)):
            expected = inside[number if fixed else 0]
            if type(content) not in _exact(expected):
                yield f"{argument}[{number}]", content, expected


def _name(kind: Any) -> str:
    """What a type is called in a message."""
    origin = get_origin(kind) or kind
    if origin in (None, type(None)):
        return "None"
    if origin is _Array:
        return "array of numbers"
    if origin is Literal:
        return type(get_args(kind)[0]).__name__
    if origin in _CONTAINERS and get_args(kind):
        return f"sequence of {' or '.join(map(_name, _alternatives(get_args(kind)[0])))}"
    return getattr(origin, "__name__", str(origin))


def _given(value: object, expected: list[str]) -> str:
    """What was given in its place, and how to make what is expected of it."""
    if isinstance(value, str | Path):
        advice = [_MAKERS[name] for name in expected if name in _MAKERS]
        if {"float", "int"} & set(expected) and _is_number(value):
            advice.append("write it without quotes")
        if any(name.startswith("sequence of str") for name in expected):
            advice.append("put it in a list")
        return "; ".join([shortened(repr(value)), *advice])
    if isinstance(value, int | float):
        return repr(value)
    if _is_array(value):
        array: Any = value
        return f"array of {array.dtype} of shape {array.shape}"
    name: str = getattr(value, "__name__", type(value).__name__)
    alone = isinstance(value, Mapping) and any(kind.startswith("sequence of str") for kind in expected)
    return f"{name}; give its keys alone" if alone else name


def _is_number(text: str | Path) -> bool:
    try:
        float(str(text))
    except ValueError:
        return False
    return True
