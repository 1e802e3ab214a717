"""Every error that linkwise raises for a reason its user can act on.

The message is one paragraph: what was given, why it is refused, what was expected and the next step. What the error is about
(file, line, link, time) is kept on the exception as attributes, so a caller need not parse the text.
"""

from __future__ import annotations

import copyreg
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from numbers import Integral, Real
from pathlib import Path
from typing import Any, TypeVar

from linkwise.display import near_miss, shortened

_NEXT_STEPS = {
    "Record": "read_record(path) reads one from a file",
    "Structure": "read_structure(path) reads one from a file",
    "Law": "Law.parse(text) makes one of a text",
    "Coefficient": "Coefficient.unknown() makes one to be identified",
    "Estimate": "identify(record, structure) returns one",
    "float": "write a number without quotes",
}
_SHOWN = 72  # characters of a law that are quoted around the position of an error


class LinkwiseError(Exception):
    """Base class of all errors of this package; ``str(error)`` is the whole message.

    Parameters
    ----------
    message : str
        What was given, why it is refused and what to do.
    arguments : sequence of str, optional
        Names of the arguments of the public function that would resolve the error, such as ``("rate",)``. An interface
        that spells them differently (a command line) can add its own spelling.

    Attributes
    ----------
    arguments : tuple of str
        As given.
    exit_code : int
        Exit code of the command line: 1 failed with a reason, 2 wrong usage or unreadable input.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.read_record("no-such-file.csv")
    ... except lw.LinkwiseError as error:
    ...     print(error)
    no-such-file.csv: there is no such file
    """

    exit_code: int = 1

    def __init__(self, message: str, *, arguments: Sequence[str] = ()) -> None:
        self.arguments = tuple(arguments)
        super().__init__(message)

    def __str__(self) -> str:
        return shortened(super().__str__())

    def __reduce__(self) -> tuple[Any, ...]:
        rebuild = copyreg.__newobj__  # type: ignore[attr-defined]  # whatever the signature of the class; in no stub
        return rebuild, (type(self), self.args[0]), dict(vars(self))


class ArgumentTypeError(LinkwiseError, TypeError):
    """An argument of another type than a function takes, or several arguments in another order.

    Parameters, attributes and exit code are those of `LinkwiseError`.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.identify("run.csv", lw.bnes_chain(2))
    ... except lw.ArgumentTypeError as error:
    ...     print(error)
    identify(record, structure): record must be of type Record, got 'run.csv'; read_record(path) reads one from a file
    """


def expect(argument: str, value: object, *kinds: type) -> None:
    """Raise `ArgumentTypeError` unless a user's value is of one of the types; float and int stand for NumPy's numbers too.

    `argument` names it after the call that shows the order, as in "nmse(true, estimated, record): record".
    """
    numbers: dict[type, type] = {float: Real, int: Integral}
    accepted = tuple(numbers.get(kind, kind) for kind in kinds)
    if type(value) in kinds or (type(value) is not bool and isinstance(value, accepted)):
        return
    raise wrong_type(argument, value, [kind.__name__.replace("NoneType", "None") for kind in kinds])


def wrong_type(argument: str, value: object, names: Sequence[str]) -> ArgumentTypeError:
    """The error of `expect`, by the names of the types."""
    name = getattr(value, "__name__", type(value).__name__)
    given = repr(value) if isinstance(value, str | Path | Real) else name
    advice = next((_NEXT_STEPS[name] for name in names if name in _NEXT_STEPS), "")
    expected = " or ".join(filter(None, [", ".join(names[:-1]), names[-1]]))
    message = f"{argument} must be of type {expected}, got {shortened(given)}"
    return ArgumentTypeError(f"{message}; {advice}" if advice else message)


def require_known(
    kind: str, name: str, known: Collection[str], error: Callable[[str], LinkwiseError] = LinkwiseError
) -> None:
    """Raise an error with all names that are `known` unless the `name` of something of a `kind` is one of them."""
    if name not in known:
        listed = ", ".join(known) or "none"
        raise error(f'unknown {kind} "{name}"{near_miss(name, known)}; choose from {listed}')


Options = TypeVar("Options")


def options_given(
    make: Callable[..., Options], options: Options | None, keywords: Mapping[str, Any]
) -> Options:
    """The options of a call that takes either an object or the keywords of `make`; TypeError for both."""
    if options is not None and keywords:
        raise TypeError(f"got options and also {', '.join(keywords)}; give one of the two")
    return make(**keywords) if options is None else options


class LawError(LinkwiseError):
    """A text that is not a valid law; the message shows a caret under the position at fault.

    Parameters
    ----------
    reason : str
        Why the law is refused.
    text : str
        The law as typed.
    position : int, optional
        Zero-based index of the character at fault; None where no single position is.
    advice : str, optional
        The next step.

    Attributes
    ----------
    reason, text, position, advice
        As given.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.Law.parse("k*d + c v")
    ... except lw.LawError as error:
    ...     print(error)
    An operator is missing between 'c' and 'v'.
      k*d + c v
              ^
    A product is written with a star: c*v.
    """

    exit_code = 2

    def __init__(self, reason: str, text: str, position: int | None = None, advice: str = "") -> None:
        self.reason, self.text, self.position, self.advice = reason, text, position, advice
        super().__init__("\n".join([reason, *_quoted(text, position), *([advice] if advice else [])]))


class _PlacedError(LinkwiseError):
    """An error in a file or a part of it, `where`, which precedes the message."""

    exit_code = 2

    def __init__(self, message: str, where: str = "", *, arguments: Sequence[str] = ()) -> None:
        self.message, self.where = message, where
        super().__init__(f"{where}: {message}" if where else message, arguments=arguments)


class StructureError(_PlacedError):
    """A structure that is not valid.

    Parameters
    ----------
    message : str
        What is wrong and what to do.
    where : str, optional
        The file, key, mass or link concerned; it precedes the message.
    arguments : sequence of str, optional
        As of `LinkwiseError`.

    Attributes
    ----------
    message, where
        As given.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.bnes_chain(2).link("nes2")
    ... except lw.StructureError as error:
    ...     print(error)
    unknown link "nes2"; did you mean "nes1"?; the links are "spring1", "nes1"
    """


class RecordError(LinkwiseError):
    """A record, or its file, that cannot be used.

    Parameters
    ----------
    message : str
        What is wrong and what to do.
    file : str or Path, optional
        The file that was read.
    line : int, optional
        Line of the file, counted from 1.
    channel : str, optional
        Name of the channel.
    arguments : sequence of str, optional
        As of `LinkwiseError`.

    Attributes
    ----------
    message, file, line, channel
        As given; None where unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.read_record("run.xyz")
    ... except lw.RecordError as error:
    ...     print(error)
    run.xyz: there is no such file
    """

    exit_code = 2

    def __init__(
        self,
        message: str,
        file: str | Path | None = None,
        line: int | None = None,
        channel: str | None = None,
        *,
        arguments: Sequence[str] = (),
    ) -> None:
        self.message, self.file, self.line, self.channel = message, file, line, channel
        places = {"": file, "line ": line, "channel ": channel}
        where = ", ".join(f"{kind}{place}" for kind, place in places.items() if place not in (None, ""))
        super().__init__(f"{where}: {message}" if where else message, arguments=arguments)


class SimulationError(LinkwiseError):
    """A simulation that cannot start or cannot continue; the message names time and mass.

    Parameters
    ----------
    message : str
        What is wrong and what to do, complete in itself.
    time : float, optional
        Time in s at which the simulation stopped.
    mass : str, optional
        Name of the mass concerned.
    arguments : sequence of str, optional
        As of `LinkwiseError`.

    Attributes
    ----------
    message, time, mass
        As given.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.simulate(lw.bnes_chain(2), duration=1.0, rate=-1.0)
    ... except lw.SimulationError as error:
    ...     print(error)
    rate must be positive and finite, got -1.0 Hz
    """

    def __init__(
        self,
        message: str,
        time: float | None = None,
        mass: str | None = None,
        *,
        arguments: Sequence[str] = (),
    ) -> None:
        self.message, self.time, self.mass = message, time, mass
        super().__init__(message, arguments=arguments)


class IdentificationError(LinkwiseError):
    """A record and a structure from which no estimate can be made.

    Parameters, attributes and exit code are those of `LinkwiseError`.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0)
    >>> try:
    ...     lw.identify(record, lw.bnes_chain(2))
    ... except lw.IdentificationError as error:
    ...     print(type(error).__name__)
    IdentificationError
    """


class OutputError(LinkwiseError):
    """An output path that cannot or must not be written.

    Parameters and attributes are those of `LinkwiseError`.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=100.0)
    >>> try:
    ...     lw.report.write_result(lw.inspect(record), "/")
    ... except lw.OutputError as error:
    ...     print(str(error).partition(";")[0])
    /: already exists and is not a result of linkwise (no valid inspection.json)
    """

    exit_code = 2


class StudyError(_PlacedError):
    """A study that cannot be run or resumed.

    Parameters
    ----------
    message : str
        What is wrong and what to do.
    where : str, optional
        The file and key, or the folder, concerned; it precedes the message.
    arguments : sequence of str, optional
        As of `LinkwiseError`.

    Attributes
    ----------
    message, where
        As given.

    Examples
    --------
    >>> import linkwise as lw
    >>> try:
    ...     lw.study.read_study("papr")
    ... except lw.StudyError as error:
    ...     print(error)
    papr: there is no such study; did you mean "paper"?; give a TOML file, or a study that ships with linkwise: paper, reach
    """


def _quoted(text: str, position: int | None) -> list[str]:
    """The line of `text` at `position`, cut to a readable length, and a caret under the position."""
    if position is None:
        return [f"  {text}" if len(text) <= _SHOWN else f"  {text[: _SHOWN - 3]}..."]
    position = min(max(position, 0), len(text))
    start = text.rfind("\n", 0, position) + 1
    end = text.find("\n", position)
    end = len(text) if end < 0 else end
    line, column = text[start:end].expandtabs(1), position - start
    before, after = "", ""
    if column > _SHOWN // 2:
        cut = min(column - _SHOWN // 2, max(len(line) - _SHOWN, 0))
        before = "..." if cut else ""
        line, column = line[cut:], column - cut
    if len(line) > _SHOWN:
        line, after = line[:_SHOWN], "..."
    return [f"  {before}{line}{after}", " " * (2 + len(before) + column) + "^"]


@contextmanager
def located(where: str) -> Iterator[None]:
    """Give a `StructureError` raised inside the place `where`, in place of its own."""
    try:
        yield
    except StructureError as error:
        raise StructureError(error.message, where) from None
