"""Old spellings of public names, attributes and keywords: they go on working, warn, and say what to write instead.

The policy (what, since when, until when) stands in CONTRIBUTING.md. A test reads every `Deprecated(...)` of the source and
fails when the version reaches its `until`, so that no old spelling outlives its promise.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from functools import wraps
from operator import attrgetter
from typing import Any, NamedTuple, ParamSpec, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class Deprecated(NamedTuple):  # a dataclass would double the time that `import linkwise` takes
    """What replaces an old spelling, the version since which it warns and the version in which it goes.

    Parameters
    ----------
    new : str
        The replacement: of a public name the name to import from linkwise, dotted where it lies deeper; of a keyword the
        keyword.
    since, until : str
        Versions, such as "0.2.0" and "0.4.0".
    """

    new: str
    since: str
    until: str

    def warn(self, old: str, new: str, *, depth: int = 3) -> None:
        """Warn that `old` is now called `new`; the warning points to the line that called the caller of this method.

        `depth` is larger by one for each decorator of that caller.
        """
        message = (
            f"{old} is deprecated since linkwise {self.since} and will be removed in {self.until}; use {new}"
        )
        warnings.warn(message, DeprecationWarning, stacklevel=depth)


class DeprecatedAttribute:
    """The old spelling of an attribute or a method, to be assigned to that spelling in the body of its class.

    Parameters
    ----------
    entry : Deprecated
        The attribute that replaces it, and the versions.
    read : callable, optional
        Gives the old value of an object; by default the value of the attribute that replaces it.

    Examples
    --------
    >>> import warnings
    >>> from linkwise.deprecation import Deprecated, DeprecatedAttribute
    >>> class Signal:
    ...     rate = 4.0
    ...     fs = DeprecatedAttribute(Deprecated("rate", since="0.2.0", until="9.0.0"))
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     Signal().fs
    4.0
    >>> print(caught[0].message)
    Signal.fs is deprecated since linkwise 0.2.0 and will be removed in 9.0.0; use Signal.rate
    """

    def __init__(self, entry: Deprecated, read: Callable[[Any], object] | None = None) -> None:
        self.entry = entry
        self._read = attrgetter(entry.new) if read is None else read

    def __set_name__(self, owner: type, name: str) -> None:
        self._owner, self._name = owner.__name__, name

    def __get__(self, instance: object, owner: type) -> Any:
        if instance is None:
            return self
        self.entry.warn(f"{self._owner}.{self._name}", f"{self._owner}.{self.entry.new}")
        return self._read(instance)


def deprecated_keyword(old: str, entry: Deprecated) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Let a function take a keyword by its old spelling too.

    Parameters
    ----------
    old : str
        The old spelling.
    entry : Deprecated
        The keyword that replaces it, and the versions.

    Returns
    -------
    callable
        A decorator. The function that it returns raises TypeError where a call gives both spellings.

    Examples
    --------
    >>> import warnings
    >>> from linkwise.deprecation import Deprecated, deprecated_keyword
    >>> @deprecated_keyword("fs", Deprecated("rate", since="0.2.0", until="9.0.0"))
    ... def period(*, rate: float) -> float:
    ...     return 1.0 / rate
    >>> with warnings.catch_warnings(record=True) as caught:
    ...     warnings.simplefilter("always")
    ...     period(fs=4.0)
    0.25
    >>> print(caught[0].message)
    keyword 'fs' of period is deprecated since linkwise 0.2.0 and will be removed in 9.0.0; use 'rate'
    """

    def decorate(function: Callable[P, R]) -> Callable[P, R]:
        @wraps(function)
        def renamed(*args: P.args, **kwargs: P.kwargs) -> R:
            if old in kwargs:
                if entry.new in kwargs:
                    raise TypeError(
                        f"{function.__qualname__} got {entry.new!r} and also {old!r}, its old spelling"
                    )
                entry.warn(f"keyword {old!r} of {function.__qualname__}", repr(entry.new))
                kwargs[entry.new] = kwargs.pop(old)
            return function(*args, **kwargs)

        return renamed

    return decorate
