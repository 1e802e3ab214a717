"""`linkwise structure`: write the paper's chain as a file, look at one, and list the named laws."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.console import deliver_structure, note
from linkwise.cli.host import host
from linkwise.cli.options import FILE, STRUCTURE, grouped, typed
from linkwise.output import to_json
from linkwise.registry import lazy_module
from linkwise.templates import filled

if TYPE_CHECKING:
    from linkwise.model import structure_file
    from linkwise.plot import estimates
else:  # matplotlib loads where a figure is drawn
    estimates = lazy_module("linkwise.plot.estimates")
    structure_file = lazy_module("linkwise.model.structure_file")

MANY = 20  # masses past which equilibria and modes are not searched for: nobody reads them in a terminal
SHOWN = 4  # stable equilibria


@click.group()
def structure() -> None:
    """Write or show a structure file.

    \b
    Examples:
      linkwise structure bnes --dof 10 --unknown nes -o chain.toml
      linkwise structure show chain.toml
      linkwise structure laws bouc-wen
      linkwise structure host wing_modes.csv -o wing.toml
    """


structure.add_command(host)


@dataclass(frozen=True)
class ChainOptions:
    """A chain of the paper, and where it goes.

    Parameters
    ----------
    dof : int
        Number of masses (even).
    unknown : str | None
        Make the coefficients of the sinks (nes) or of all links (all) unknown.
    output : Path | None
        File to write; without it, standard output.
    as_json : bool
        Print the structure as JSON and nothing else.
    """

    dof: int = typed("N", type=int, required=True)
    unknown: str | None = typed(type=click.Choice(["nes", "all"]))
    output: Path | None = typed("FILE", "-o", "--output", type=FILE)
    as_json: bool = typed(None, "--json", is_flag=True)


@structure.command()
@grouped(ChainOptions, "options")
def bnes(options: ChainOptions) -> None:
    """Print the paper's chain of bistable energy sinks as a structure file.

    \b
    Example:
      linkwise structure bnes --dof 10 --unknown nes -o chain.toml
    """
    chain = lw.bnes_chain(options.dof)
    written = chain.unknown(options.unknown) if options.unknown else chain
    deliver_structure(written, options.output, as_json=options.as_json)


@dataclass(frozen=True)
class ShownOptions:
    """What is shown of a structure, and how.

    Parameters
    ----------
    shapes : Path | None
        Draw the shapes of hosts at their points into PICTURE.png and PICTURE.svg.
    as_json : bool
        Print the answer as JSON and nothing else.
    """

    shapes: Path | None = typed("PICTURE", type=FILE)
    as_json: bool = typed(None, "--json", is_flag=True)


@structure.command()
@click.argument("file", type=STRUCTURE)
@grouped(ShownOptions, "options")
def show(file: Path, options: ShownOptions) -> None:
    """Show the masses, hosts and links of FILE, and where it can rest and how it vibrates there.

    \b
    Examples:
      linkwise structure show chain.toml
      linkwise structure show wing.toml --shapes wing
    """
    subject = lw.read_structure(file)
    if options.shapes is not None:
        for path in lw.plot.save(estimates.shapes_figure(subject), _without_suffix(options.shapes)):
            note(f"{path} is written")
    why = _why_no_rests(subject)
    rests = None
    if why is None:
        try:
            rests = _rests(subject)
        except lw.StructureError as error:  # as where the force of a link vanishes without end
            why = str(error)
    if options.as_json:
        click.echo(to_json({**structure_file.structure_tables(subject), "equilibria": rests}))
        return
    written = {"subject": subject, "stem": file.stem, "rests": rests, "why": why}
    click.echo(filled("cli", "structure.txt.jinja", shown=_shown, **written).rstrip())


@structure.command()
@click.argument("name", required=False)
@click.option("--json", "as_json", is_flag=True, help="Print the laws as JSON and nothing else.")
def laws(name: str | None, as_json: bool) -> None:
    """List the named laws, or print NAME as a link to paste into a structure file and edit.

    A structure file takes a name in place of a law: law = "bouc-wen", or law = "iwan(8)" with a number of sliders.

    \b
    Example:
      linkwise structure laws
      linkwise structure laws bouc-wen
    """
    chosen = {known: lw.model.named_law(known) for known in ([name] if name else lw.model.NAMED_LAWS)}
    if as_json:
        click.echo(to_json({key: _law_document(law) for key, law in chosen.items()}))
    elif name:
        click.echo(_link_text(name, chosen[name]))
    else:
        click.echo(filled("cli", "laws.txt.jinja", laws=chosen, parsed_of=_parsed).rstrip())


def _without_suffix(picture: Path) -> Path:
    """The path without .png or .svg, both of which are written."""
    return picture.with_suffix("") if picture.suffix.lower() in (".png", ".svg") else picture


def _parsed(law: lw.model.NamedLaw) -> lw.Law:
    return lw.Law.parse(law.law, law.states)


def _law_document(law: lw.model.NamedLaw) -> dict[str, Any]:
    parsed = _parsed(law)
    rates = {key: {"rate": state.rate, "unit": parsed.state_units[key]} for key, state in law.states.items()}
    about = {key: {"unit": unit, "meaning": law.coefficients[key]} for key, unit in parsed.units.items()}
    document = {"title": law.title, "law": law.law, "states": rates, "coefficients": about}
    return {**document, "source": law.source}


_ENDS = 'between: two masses or points of hosts, one of them and "ground" or "base", or on a rig "base" and "ground"'


def _link_text(name: str, law: lw.model.NamedLaw) -> str:
    """The `[[link]]` table of a structure file with the law written out."""
    masses = tuple(lw.Mass(end, 1.0) for end in ("m2", "m1"))
    link = law.link(name.partition("(")[0], ("m2", "m1"))
    text = lw.model.format_structure(lw.Structure("", masses, (link,)))
    table = text[text.index("[[link]]") :].rstrip()
    return f"# {law.title}\n# {law.source}\n# {_ENDS}\n{table}"


def _shown(coefficient: lw.Coefficient) -> str:
    if coefficient.same_as is not None:
        return f"{coefficient.same_as} in"
    if coefficient.sigma < math.inf:
        return f"{coefficient.value:g} +- {coefficient.sigma:g}"
    if coefficient.known or coefficient.value is not None:
        start = "" if coefficient.known else " (start)"
        return f"{coefficient.value:g}{start}"
    return "unknown"


def _why_no_rests(subject: lw.Structure) -> str | None:
    """Why equilibria are not searched for, where they are not."""
    if subject.signals:
        return f"laws name the signal {next(iter(subject.signals))}"
    if with_memory := [link.name for link in subject.links if link.law.states]:
        return f"link {with_memory[0]} has memory"
    if subject.parameters:
        return "coefficients are unknown"
    return f"it has more than {MANY} masses" if subject.size > MANY else None


def _rests(subject: lw.Structure) -> dict[str, Any]:
    """Stable equilibria and their modes as plain data."""
    points = lw.analysis.equilibria(subject)
    stable = [rest for rest in points if rest.stable]
    counts = {"stable": len(stable), "unstable": len(points) - len(stable), "note": points.note}
    return {**counts, "first": [_rest(subject, rest) for rest in stable[:SHOWN]]}


def _rest(subject: lw.Structure, rest: lw.analysis.Equilibrium) -> dict[str, Any]:
    modes = lw.analysis.modes(subject, at=rest.x)
    return {
        "x": dict(zip(subject.mass_names, rest.x.tolist(), strict=True)),
        "energy": float(rest.energy),
        "frequencies": modes.frequencies.tolist(),
        "damping": modes.damping.tolist(),
    }
