"""`linkwise discover`: records and the masses, to who is linked to whom and by which law."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, nmse_lines, note, progress, truth_option
from linkwise.cli.help import listing, screen
from linkwise.cli.options import FILE, STRUCTURE, grouped, method_options, pairs, quantity, typed
from linkwise.cli.reading_options import RecordOptions, record_options, tell_of_hosts
from linkwise.discovery import terms as families
from linkwise.model import link
from linkwise.output import RESULT

EXAMPLE = "m1=1.0"


@dataclass(frozen=True)
class PriorOptions:
    """What is known of the structure, and further records.

    Parameters
    ----------
    mass : tuple[str, ...]
        A mass, in kg or with a unit, as in m1=1.0 or "m2=10 g", or the inertia of one that turns, as in "disc=2 g
        m^2"; if only ratios of masses are known, forces are relative to them; NAME=unknown if an applied force or
        another mass sets the scale. Repeatable, once for every mass.
    structure : Path | None
        A structure file with the masses and the known links, instead of --mass.
    more : tuple[Path, ...]
        Another record of the same structure, read with the same options and fitted together with it. Repeatable.
    """

    mass: tuple[str, ...] = typed("NAME=KG", multiple=True)
    structure: Path | None = typed("FILE", type=STRUCTURE)
    more: tuple[Path, ...] = typed("RECORD", "--with", multiple=True, type=FILE)

    def masses(self, mapping: lw.files.RecordMapping) -> lw.model.PartialStructure | dict[str, float | str]:
        """The masses by name, or what a file knows of the structure; UsageError for neither and for both.

        Those of the mapping file are taken where no option gives any.
        """
        if self.structure is not None and self.mass:
            raise UsageError("The file of --structure states the masses: give either --mass or --structure.")
        if self.structure is not None:
            known = lw.model.read_partial_structure(self.structure)
            tell_of_hosts(known.hosts)
            return known
        if not self.mass and not mapping.masses:
            raise UsageError(
                f'Give every mass by name, as in --mass {EXAMPLE} --mass "m2=10 g" (ratios will do for forces in '
                "those units), in the table [mass] of a file with --mapping, or in a file with --structure."
            )
        stated = pairs(self.mass, "--mass", EXAMPLE).items()
        return dict(mapping.masses) | {name: mass_value(name, text) for name, text in stated}


def mass_value(name: str, text: str) -> float | str:
    """A plain number, a text with a unit of inertia, or "unknown"; UsageError for anything else."""
    if text.strip() == "unknown":
        return "unknown"
    return text if link.is_inertia(text) else quantity(text, "kg", f"--mass {name}")


@click.command(
    cls=screen(
        *("mass", "structure", "terms", "mapping", "channel", "rate", "more", "admit", "output", "as_json"),
        base=listing("FAMILIES", lambda: families.listed_families()),
    )
)
@record_options
@grouped(PriorOptions, "prior")
@method_options(lw.discovery.DiscoveryOptions, "given")
@answer_options(RESULT, truth_option)
def discover(source: RecordOptions, prior: PriorOptions, given: dict[str, Any], delivery: Delivery) -> int:
    """Discover which masses are linked, and by which laws, from RECORD and the masses alone.

    Every mass needs a sensor, unless the structure has hosts. Candidates are links between all pairs of masses, between every
    mass and the ground and, if x:base is recorded, the base, each with all --terms. With --structure, links in the file keep
    their terms, and others may be added. Exit code 3 means that the search did not settle or the fit is refused, 4 that it is
    approximate; Ctrl-C ends the search with the best result so far.

    \b
    Examples:
      linkwise discover run.csv --mass m1=1.0 --mass "m2=10 g" -o found
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.01 --terms "cubic, friction, gap"
      linkwise discover run.csv --structure known.toml --with run2.csv --json
      linkwise discover run.csv --mapping sensors.toml
    \f
    \b
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.01 --terms "cubic, friction(0.01)" --truth chain.toml
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.5 --terms "cubic, bouc-wen"
      linkwise discover hits.csv --structure two_beams.toml --terms "cubic, friction(0.02)" -o joint
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.01 --calibration all=1%
      linkwise discover run.csv --mass m1=1.0 --mass m2=0.01 --sensor x:m2:delay --let offset,gain
      linkwise discover wind.csv --mass m1=1.0 --mass m2=0.5 --ambient all

    Beside functions of d and v, --terms accepts these families:

    \b
      FAMILIES

    The list may also name a law with memory, such as bouc-wen, dahl or zener ("linkwise structure laws" lists all), which is
    then tried in each link. If it names none, bouc-wen, dahl and zener are tried if the terms leave more than 3 % of the
    forces unexplained.

    Without a number, S or G is estimated for each link, as is any other name inside a function: "tanh(v/vr)". The term 1 is a
    constant force on each mass.

    A link with the law "0" is known to be absent, as is a term with a coefficient of 0. With hosts in the file, links may end
    at their points as at masses, and accelerometers at some of the points are enough. What the record cannot determine is
    reported on standard error before the search.
    """
    masses = prior.masses(source.record_mapping())
    try:
        options = lw.discovery.DiscoveryOptions(**source.beside_errors(given))
    except lw.IdentificationError as error:
        raise UsageError(f"--terms: {error}") from error
    names = tuple(masses) if isinstance(masses, dict) else masses.places
    true = None if delivery.truth is None else _true(delivery.truth, names)
    with progress("reading") as step:
        records = [_read(replace(source, record=path), names) for path in (source.record, *prior.more)]
        step(lw.estimates.ProgressReport(0.0, "looking at the record"))
        note(*lw.discovery.check_discovery(records, masses, options))
        discovery = lw.discover(records, masses, options, progress=step)
    if true is not None and not all(link.law.is_plain for link in discovery.structure.links):
        note("a law with memory or a signal was found, so the answer is not compared with the truth")
        true = None
    more = _comparison_lines(lw.report.result_of(discovery, true))
    return delivery.of(discovery, more=more, truth=true)


def _read(source: RecordOptions, names: tuple[str, ...]) -> lw.Record:
    """The record; a channel of a mass that was not given is an error that says how to give it."""
    try:
        return source.read(names)
    except lw.RecordError as error:
        if error.channel is None or "known_masses" not in error.arguments:
            raise
        mass = error.channel.partition(":")[2]
        message = f"{error.message}. Add --mass {mass}=... for it, or take the column out of the record"
        raise lw.RecordError(message, error.file, error.line, error.channel) from error


def _true(path: Path, names: tuple[str, ...]) -> lw.Structure:
    """The true structure; refused before the work where it has other masses or says nothing of a coefficient."""
    structure = lw.read_structure(path)
    link.refuse_memory(structure.links, link.COMPARISON)
    unknown = [parameter.name for parameter in structure.parameters]
    if unknown:
        raise lw.StructureError(
            f"{unknown[0]} is unknown, and the truth that the answer is compared with knows every coefficient: give a number",
            str(path),
        )
    try:
        for name in names:
            if name not in structure.places:
                structure.mass(name)  # says which there are
    except lw.StructureError as error:
        raise lw.StructureError(error.message, str(path)) from error
    return structure


def _comparison_lines(result: dict[str, Any]) -> list[str]:
    """Which terms are right and how far each force is from the true one, where a truth was given."""
    if "truth" not in result:
        return []
    truth = result["truth"]
    return [
        f"\nagainst the truth: {len(truth['right'])} terms right",
        f"  missing  {', '.join(truth['missing']) or 'none'}",
        f"  false    {', '.join(truth['extra']) or 'none'}",
        *nmse_lines(result, "  NMSE of the force (paper Eq. 8)", "    "),
    ]
