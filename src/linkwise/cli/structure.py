"""`linkwise structure`: write the paper's chain as a file, and look at one."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import click

import linkwise as lw
from linkwise.atomic import atomic_file, to_json
from linkwise.cli.options import FILE

MANY = 20  # masses past which equilibria and modes are not searched for: nobody reads them in a terminal
SHOWN = 4  # stable equilibria


@click.group()
def structure() -> None:
    """Write or show a structure file."""


@structure.command()
@click.option("--dof", metavar="N", type=int, required=True, help="Number of masses, even.")
@click.option(
    "--unknown", type=click.Choice(["nes", "all"]), help="Leave the sinks' or all coefficients unknown."
)
@click.option("-o", "--output", metavar="FILE", type=FILE, help="File to write; without it, standard output.")
@click.option("--json", "as_json", is_flag=True, help="Print the structure as JSON and nothing else.")
def bnes(dof: int, unknown: str | None, output: Path | None, as_json: bool) -> None:
    """Print the paper's chain of bistable energy sinks as a structure file.

    \b
    Example:
      linkwise structure bnes --dof 10 --unknown nes -o chain.toml
    """
    chain = lw.bnes_chain(dof)
    written = chain.unknown(unknown) if unknown else chain
    if output is not None:
        with atomic_file(output) as partial:
            lw.write_structure(written, partial)
    text = lw.format_structure(written)
    if as_json:
        click.echo(to_json(tomllib.loads(text)))
    elif output is None:
        click.echo(text.rstrip())


@structure.command()
@click.argument("file", type=FILE)
@click.option("--json", "as_json", is_flag=True, help="Print the answer as JSON and nothing else.")
def show(file: Path, as_json: bool) -> None:
    """Show the masses and links of FILE, and where it can rest and how it vibrates there.

    \b
    Example:
      linkwise structure show chain.toml
    """
    subject = lw.read_structure(file)
    rests = _rests(subject)
    if as_json:
        text = to_json({**tomllib.loads(lw.format_structure(subject)), "equilibria": rests})
        click.echo(text)
        return
    click.echo(f"{subject.name or file.stem}: {subject.size} masses, {len(subject.links)} links")
    for mass in subject.masses:
        click.echo(f"  {mass.name:10} {_shown(mass.mass)} kg")
    for link in subject.links:
        numbers = ", ".join(
            f"{name} = {_shown(coefficient)} {link.law.units[name]}"
            for name, coefficient in link.coefficients.items()
        )
        click.echo(f"  {link.name:10} {link.between[0]} - {link.between[1]}: {link.law.text}; {numbers}")
    click.echo(_told(subject, rests))


def _shown(coefficient: lw.Coefficient) -> str:
    if coefficient.known or coefficient.value is not None:
        start = "" if coefficient.known else " (start)"
        return f"{coefficient.value:g}{start}"
    return "unknown"


def _rests(subject: lw.Structure) -> dict[str, Any] | None:
    """Stable equilibria and their modes as plain data; None where coefficients are unknown or masses too many."""
    if subject.parameters or subject.size > MANY:
        return None
    points = lw.equilibria(subject)
    stable = [rest for rest in points if rest.stable]
    return {
        "stable": len(stable),
        "unstable": len(points) - len(stable),
        "note": points.note,
        "first": [_rest(subject, rest) for rest in stable[:SHOWN]],
    }


def _rest(subject: lw.Structure, rest: lw.Equilibrium) -> dict[str, Any]:
    modes = lw.modes(subject, at=rest.x)
    return {
        "x": dict(zip(subject.mass_names, map(float, rest.x), strict=True)),
        "energy": float(rest.energy),
        "frequencies": [float(frequency) for frequency in modes.frequencies],
        "damping": [float(ratio) for ratio in modes.damping],
    }


def _told(subject: lw.Structure, rests: dict[str, Any] | None) -> str:
    if rests is None:
        why = "coefficients are unknown" if subject.parameters else f"it has more than {MANY} masses"
        return f"  equilibria and modes are not shown: {why}"
    lines = [
        f"  equilibria: {rests['stable']} stable, {rests['unstable']} unstable. {rests['note']}".rstrip()
    ]
    for rest in rests["first"]:
        places = ", ".join(f"{name} = {x:.4g} m" for name, x in rest["x"].items())
        pairs = zip(rest["frequencies"], rest["damping"], strict=True)
        tones = ", ".join(f"{frequency:.4g} Hz ({100 * ratio:.2g} %)" for frequency, ratio in pairs)
        lines += [f"    {places}; energy {rest['energy']:.4g} J", f"      modes (damping): {tones}"]
    if rests["stable"] > SHOWN:
        lines.append(f"    and {rests['stable'] - SHOWN} more stable ones")
    return "\n".join(lines)
