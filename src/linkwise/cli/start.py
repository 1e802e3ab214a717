"""`linkwise start`: from files that somebody else wrote to a first answer; what is missing is asked, or named as an option."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial, reduce
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import fail, note, noting_once, tell
from linkwise.cli.discover import discover, mass_value
from linkwise.cli.identify import identify
from linkwise.cli.inspect import inspect
from linkwise.cli.options import FOLDER, POSITIVE, grouped, header_line, pairs, typed, with_flags
from linkwise.cli.reading_options import records_argument
from linkwise.display import align_columns
from linkwise.files import column_guesses as columns
from linkwise.files import read_table
from linkwise.files.table import Table
from linkwise.inspection.channel_faults import driven_mass
from linkwise.model.chains import link_table
from linkwise.model.coefficient import quoted
from linkwise.model.link import GROUND, mass_in_si
from linkwise.output import RESULT, atomic_file, check_result_folder
from linkwise.records.channel import BASE, KINDS, Channel
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from rich import console as terminal
    from rich import prompt, text
else:  # rich is for terminals
    terminal = lazy_module("rich.console")
    prompt = lazy_module("rich.prompt")
    text = lazy_module("rich.text")

R = TypeVar("R")
_RUN: dict[str, click.Command] = {"inspect": inspect, "identify": identify, "discover": discover}
_STRUCTURE = """# A structure file of linkwise, written by linkwise start. Numbers are SI; "120 g" or "30 N/mm" has a unit.
# A law is a force in d, the displacement of the first end of a link less that of the second, and v, its rate; an end is a
# mass, "ground", or "base", which moves with a recorded base motion.
# A coefficient is a number where it is known, "unknown" where it is to be identified, { start = 0.02, lower = 0.0 } with a
# start or bounds, { start = 1.6, sigma = 0.1 } where it is known to within, "=leaf.k" where it is equal to another one.

"""


@dataclass(frozen=True)
class StartOptions:
    """What is known of a test. What is not given is guessed from the columns, or asked.

    Parameters
    ----------
    records : tuple of Path
        The records.
    mass : tuple[str, ...]
        A mass in kg or with a unit, as in frame=1.8 or "sink=120 g"; NAME=unknown if an applied force sets the scale.
        Repeatable, once for every mass.
    link : tuple[str, ...]
        A link with its law, as in "nes: sink - frame: alpha*d + beta*d**3 + c*v"; ends are masses, ground or base.
        Repeatable. Without any the links are discovered.
    known : tuple[str, ...]
        A coefficient that is known, as in leaf.c=1.6 or "leaf.k=30 N/mm". Repeatable.
    channel : tuple[str, ...]
        The column that holds a channel, as in "x:frame[mm]=Laser 1"; kinds are x, v, a and force. Repeatable.
    leave_out : tuple[str, ...]
        A column that is no channel. Repeatable.
    rate : float | None
        Sampling rate of a file without a time column.
    resample : float | None
        Rate to which uneven times are interpolated.
    header : str | int | None
        The header line of a text file, if it is not found: its number, or text that it contains.
    yes : bool
        Take what is guessed without asking; what cannot be guessed is an error that names the option.
    output : Path | None
        Folder for all that is written.  [default: the record's name]
    """

    records: tuple[Path, ...]
    mass: tuple[str, ...] = typed("NAME=KG", multiple=True)
    link: tuple[str, ...] = typed("NAME: A - B: LAW", multiple=True)
    known: tuple[str, ...] = typed("NAME=VALUE", multiple=True)
    channel: tuple[str, ...] = typed("NAME=COLUMN", multiple=True)
    leave_out: tuple[str, ...] = typed("COLUMN", multiple=True)
    rate: float | None = typed("HZ", type=POSITIVE)
    resample: float | None = typed("HZ", type=POSITIVE)
    header: str | int | None = typed("LINE", callback=header_line)
    yes: bool = typed(is_flag=True)
    output: Path | None = typed("DIR", "-o", "--output", type=FOLDER)


@click.command()
@grouped(StartOptions, "options", records_argument)
def start(options: StartOptions) -> int:
    """Get from the files of a test to a first answer: what do the columns hold, what is known, which laws follow?

    Shows what each column of the first RECORD may hold, asks what is missing, writes sensors.toml and structure.toml into
    DIR, looks at the record, identifies the links, or discovers them where none is given, and prints the commands that it
    ran, to be repeated after the two files are edited. Every answer is an option too. Further RECORDs are of the same test
    with the same columns. The exit code is that of identify or discover.

    \b
    Examples:
      linkwise start rig.csv
      linkwise start rig.csv --mass frame=1.8 --mass "sink=120 g" --yes
      linkwise start rig.csv --mass frame=1.8 --mass "sink=120 g" --link "leaf: frame - ground: k*d + c*v" \\
        --link "nes: sink - frame: alpha*d + beta*d**3 + c*v" --yes -o answer
      linkwise start log.csv --mass m1=1.2 --channel "a:m1[g]=AI 3" --channel "force:m1[N]=AI 4" --rate 2048 --yes
    """
    folder = options.output or Path(options.records[0].stem)
    given = pairs(options.mass, "--mass", "frame=1.8")
    masses = {name: mass_value(name, text) for name, text in given.items()}
    test = _Test(options, masses, read_table(options.records[0], options.header))
    test = test.with_masses().with_columns().with_rate().with_forces()
    links = test.links()
    sensors, structure = folder / "sensors.toml", folder / "structure.toml"
    _refuse_overwriting(sensors, structure)
    if options.known and not links:
        raise UsageError("--known states coefficients of links, and no --link is given.")
    values = pairs(options.known, "--known", "leaf.c=1.6")
    known = {name: _number_or_text(text) for name, text in values.items()}
    built = lw.rig(test.masses, links, known, name=folder.name) if links else None
    check_result_folder(folder / "answer")
    _write(sensors, columns.mapping_text(str(options.records[0]), test.guesses, test.mapping))
    if built is not None:
        _write(structure, _STRUCTURE + lw.model.format_structure(built))
    with noting_once():
        return _run(options.records, sensors, None if built is None else structure, folder / "answer")


@dataclass(frozen=True)
class _Test:
    """What is known of a test so far: options, masses, the columns as they are guessed, and those that were answered."""

    options: StartOptions
    masses: Mapping[str, float | str]
    table: Table
    answered: Mapping[str, str] = field(default_factory=dict)
    left_out: tuple[str, ...] = ()
    rate: float | None = None

    @cached_property
    def guesses(self) -> tuple[columns.ColumnGuess, ...]:
        """What each column may hold."""
        given = {**pairs(self.options.channel, "--channel", "x:m1=COLUMN"), **self.answered}
        left_out = (*self.options.leave_out, *self.left_out)
        return columns.guessed_columns(self.table, tuple(self.masses), given, left_out)

    @property
    def mapping(self) -> lw.files.RecordMapping:
        """The columns, the masses and the rate as a mapping file states them."""
        named = {_key(guess): guess.label for guess in self.guesses if guess.name}
        options, rate = self.options, self.options.rate or self.rate
        return lw.files.RecordMapping(
            named, masses=self.masses, rate=rate, resample=options.resample, header=options.header
        )

    def with_masses(self) -> _Test:
        """The test with its masses, which no file states: names are guessed from columns, numbers are asked."""
        if self.masses:
            return self
        self._show()
        proposed = columns.proposed_masses(self.guesses) or ("m1",)
        missing = f"No mass is given, and a record does not state it: give {_mass_options(proposed)}."
        self._require_person(missing)
        names = _ask("Names of the masses", ", ".join(proposed), str).split(",")
        question = 'Mass of {}: kg, a unit, or "unknown"'
        asked = ((name, question.format(name)) for name in map(str.strip, names))
        return replace(
            self, masses={name: _ask(text, None, partial(mass_value, name)) for name, text in asked}
        )

    def with_columns(self) -> _Test:
        """The test with no column in doubt but forces of which only the mass is."""
        doubtful = [guess for guess in self.guesses if guess.doubts and not _is_of_force(guess)]
        channels = [guess.name for guess in self.guesses if isinstance(guess.name, Channel)]
        moving = [channel for channel in channels if channel.is_motion and not channel.is_input]
        shown = self._show()
        self._require_masses(channels)
        if not moving and not doubtful:
            doubtful = [guess for guess in self.guesses if not guess.name]
            if not doubtful:
                others = columns.not_numbers(self.table) or "there are no others"
                raise self.table.error(f"no column of numbers is the motion of a mass; {others}")
        if doubtful:
            every = [guess for guess in self.guesses if guess.doubts]
            self._require_person(_of_doubts(every or doubtful, self.masses))
            return self._answered(doubtful[0]).with_columns()
        if shown and not self.options.yes:
            advice = "give --yes to take it, or state columns by --channel"
            self._require_person(f"What is guessed above is not confirmed: {advice}.")
            if _ask("Is that so? y or n", "y", str).lower().startswith("n"):
                return reduce(_Test._answered, self.guesses, self)
        return self

    def _require_masses(self, channels: Sequence[Channel]) -> None:
        """UsageError where a header names a mass that is not given."""
        doubted = [guess.name for guess in self.guesses if guess.doubts]
        places = dict.fromkeys(c.place for c in channels if c.at_place and c not in doubted)
        foreign = [place for place in places if place not in (*self.masses, BASE)]
        if foreign:
            raise UsageError(
                f"The record has channels of {quoted(foreign)}, and the masses are {quoted(self.masses)}: "
                f"give {_mass_options(foreign)}, or --leave-out the columns."
            )

    def _show(self) -> bool:
        """Print what the columns hold; whether any of it is guessed."""
        rows = []
        for guess in self.guesses:
            why = " ".join(guess.doubts) or (guess.why and f"by its {guess.why}")
            rows.append((str(guess.label), guess.name or "not used", *_quantity(guess), why))
        tell("\n".join(align_columns([("column", "holds", "quantity", "unit", "guessed"), *rows])))
        if texts := columns.not_numbers(self.table):
            advice = "To use such a column, leave the cells of missing samples empty"
            tell(f"Not used, since they are not numbers alone: {texts}. {advice}.")
        return any(guess.why for guess in self.guesses)

    def _answered(self, guess: columns.ColumnGuess) -> _Test:
        """The test with what a person says of a column."""
        known = _key(guess) or "-"
        default = None if columns.NO_UNIT in guess.doubts else known
        example = f"{_key(guess)}, " if default is None and guess.name else ""
        question = f'Column "{guess.header}" holds ({example}KIND:MASS[UNIT], time, or - for nothing)'

        def read(said: str) -> _Test:
            label = str(guess.label)
            if said == "-":
                return replace(self, left_out=(*self.left_out, label))
            test = replace(self, answered={**self.answered, said: label})
            return test if test.guesses else self  # raises RecordError for what is no channel

        return _ask(question, default, read)

    def with_rate(self) -> _Test:
        """The test with its sampling rate, where no column is the time and the file does not state it."""
        if self.table.rate or self.mapping.rate or any(guess.name == "time" for guess in self.guesses):
            return self
        missing = "No column holds the time, and the file does not state its sampling rate"
        self._require_person(f"{missing}: give --rate HZ.")
        return replace(self, rate=_ask("Sampling rate in Hz", None, float))

    def with_forces(self) -> _Test:
        """The test with the mass on which each force acts: what the record says of it, else what a person says."""
        doubtful = [guess for guess in self.guesses if guess.doubts]
        if not doubtful:
            return self
        guess = doubtful[0]
        record = lw.read_record(self.options.records[0], mapping=self.mapping)
        known = {name: mass_in_si(mass)[0] for name, mass in self.masses.items() if mass != "unknown"}
        mass = driven_mass(record, guess.name, known) if len(known) == len(self.masses) else None
        if mass is None:
            self._require_person(_of_doubts([guess], self.masses))
            return self._answered(guess).with_forces()
        evidence = "where the force is large, its acceleration times its mass is the force"
        note(f"{guess.label} acts on {mass}: {evidence}.")
        channel = _key(replace(guess, name=Channel("force", mass)))
        return replace(self, answered={**self.answered, channel: str(guess.label)}).with_forces()

    def links(self) -> dict[str, str]:
        """The links that are given, or said; none to discover them."""
        links = dict(_named(text) for text in self.options.link)
        if links or self.options.yes:
            return links
        advice = 'give each by --link "NAME: A - B: LAW", or --yes to discover them'
        self._require_person(f"No link is given: {advice}.")
        on_base = any(guess.name.partition(":")[2] == BASE for guess in self.guesses)
        end = BASE if on_base else GROUND
        chain = zip(self.masses, [end, *self.masses], strict=False)
        tell("Which links are known to be there? For example, as a chain:")
        tell("\n".join(f"  {mass}_link: {mass} - {other}: k*d + c*v" for mass, other in chain))
        question = "NAME: A - B: LAW, or nothing to go on (without any, links are discovered)"
        while said := _ask(question, "", _checked):
            links |= said
        return links

    def _require_person(self, otherwise: str) -> None:
        """UsageError `otherwise`, which names the option, where nobody can be asked."""
        if self.options.yes or not _is_attended():
            raise UsageError(otherwise)


def _mass_options(names: Iterable[str]) -> str:
    """The options that state masses of these names."""
    return " ".join(f"--mass {shlex.quote(f'{name}=KG')}" for name in names)


def _is_attended() -> bool:
    """Whether somebody sits at a terminal."""
    return sys.stdin.isatty() and sys.stderr.isatty()


def _is_of_force(guess: columns.ColumnGuess) -> bool:
    """Whether the mass of a force is all that is in doubt, which the record may tell."""
    return isinstance(guess.name, Channel) and guess.name.is_force and guess.doubts == (columns.NO_MASS,)


def _quantity(guess: columns.ColumnGuess) -> tuple[str, str]:
    """The quantity that a column may hold and its unit, an SI unit where the header states none and need not."""
    if not isinstance(guess.name, Channel):
        return guess.name, guess.unit or ("s" if guess.name and not guess.doubts else "")
    unit = "" if columns.NO_UNIT in guess.doubts else guess.name.unit
    return KINDS[guess.name.kind].quantity, guess.unit or unit


def _of_doubts(doubtful: Sequence[columns.ColumnGuess], masses: Mapping[str, float | str]) -> str:
    """What is in doubt, and the options that settle it."""
    doubts = {one.label: "; ".join([_quantity(one)[0] or "no guess", *one.doubts]) for one in doubtful}
    said = [f"{label} ({text})" for label, text in doubts.items()]
    example = f"x:{next(iter(masses))}[mm]"
    leave_out = f"--leave-out {shlex.quote(str(doubtful[-1].label))}"
    open_ = [guess for guess in doubtful if columns.OTHER_TIME not in guess.doubts]
    if not open_:
        return (
            f"What columns hold is in doubt: {', '.join(said)}. Write a row for every sample of the fastest, with empty cells "
            f"of the others, or {leave_out} if the channels share the other times."
        )
    named = [guess for guess in open_ if guess.name] or open_[:1]
    stated = (shlex.quote(f"{_key(guess) or example}={guess.label}") for guess in named)
    options = " ".join(f"--channel {text}" for text in stated)
    return (
        f"What columns hold is in doubt: {', '.join(said)}. State it, for example by {options} (x, v, a or force; masses are "
        f"{quoted(masses)}), or {leave_out}."
    )


def _key(guess: columns.ColumnGuess) -> str:
    """A guess as the name of a channel is typed, with a unit to be replaced where none is stated."""
    unit = guess.unit or ("UNIT" if columns.NO_UNIT in guess.doubts else "")
    return f"{guess.name}[{unit}]" if unit and guess.name else guess.name


def _ask(question: str, default: str | None, read: Callable[[str], R]) -> R:
    """What `read` makes of the answer of a person, who is asked again where it makes nothing of it."""
    shown = text.Text(question)  # brackets of units are no markup
    console = terminal.Console(stderr=True)
    while True:
        try:
            said = prompt.Prompt.ask(shown, console=console, default=default, show_default=bool(default))
            if said is not None and (said.strip() or default is not None):
                return read(said.strip())
        except EOFError as error:  # Ctrl-D
            raise click.Abort from error
        except (UsageError, lw.LinkwiseError, ValueError) as error:
            tell(error.format_message() if isinstance(error, UsageError) else str(error))


def _named(text: str) -> tuple[str, str]:
    """The name of a link and the rest of what is typed."""
    name, colon, rest = (part.strip() for part in text.partition(":"))
    if not (name and colon and rest):
        message = f'--link {text!r} is not NAME: A - B: LAW, as in --link "leaf: frame - ground: k*d + c*v".'
        raise UsageError(message)
    return name, rest


def _checked(text: str) -> dict[str, str]:
    """A link as a person types it, none for nothing; an error for a law that cannot be."""
    if not text:
        return {}
    name, rest = _named(text)
    link_table(name, rest)
    return {name: rest}


def _number_or_text(text: str) -> float | str:
    try:
        return float(text)
    except ValueError:
        return text


def _refuse_overwriting(*paths: Path) -> None:
    for path in paths:
        if path.exists():
            raise lw.OutputError(
                f"{path}: is there already, and what was edited in it would be lost; edit it and repeat identify or "
                "discover, or give another folder with -o"
            )


def _write(path: Path, text: str) -> None:
    with atomic_file(path) as partial:
        partial.write_text(text, encoding="utf-8", newline="\n")


def _run(records: Sequence[Path], sensors: Path, structure: Path | None, answer: Path) -> int:
    """Run the commands, each told as it is typed; the exit code of the last."""
    first, *more = map(str, records)
    mapping = ["--mapping", str(sensors)]
    further = [word for record in more for word in ("--with", record)]
    question = ["discover", first] if structure is None else ["identify", first, str(structure)]
    commands = [["inspect", first, *more, *mapping], [*question, *further, *mapping, "-o", str(answer)]]
    status = 0
    for name, *arguments in commands:
        tell(f"\n$ linkwise {shlex.join([name, *arguments])}")
        try:
            status = _RUN[name].main(arguments, prog_name=f"linkwise {name}", standalone_mode=False) or 0
        except lw.LinkwiseError as error:  # it may advise options of that command, which is to be repeated
            fail(with_flags(error, _RUN[name]))
            status = error.exit_code
            break
    written = " and ".join(str(path) for path in (sensors, structure) if path is not None)
    tell(f"\nTo go on, edit {written} and repeat:")
    tell("\n".join(f"  linkwise {shlex.join(command)}" for command in commands))
    if (answer / RESULT).is_file():
        tell("To test the answer on a record that it has not seen, with the same columns:")
        tell(f"  linkwise validate SECOND_RECORD {shlex.join([str(answer), *mapping])}")
    return int(status)
