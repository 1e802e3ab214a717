"""`linkwise identify`, and `compare` of all methods: records and a structure with unknowns, to the force of every link."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click import UsageError

import linkwise as lw
from linkwise.cli.console import Delivery, answer_options, nmse_lines, note, progress, truth_option
from linkwise.cli.help import screen
from linkwise.cli.options import FILE, STRUCTURE, grouped, method_options, option_name, stated, typed
from linkwise.cli.reading_options import RecordOptions, read_told, record_options
from linkwise.identification.identify import METHODS
from linkwise.model import link
from linkwise.output import COMPARISON, RESULT
from linkwise.registry import lazy_module

if TYPE_CHECKING:
    from linkwise.identification import compare as comparisons
else:  # its free runs and simulations load where methods are compared
    comparisons = lazy_module("linkwise.identification.compare")


@dataclass(frozen=True)
class FitOptions:
    """The method, and the records that are fitted.

    Parameters
    ----------
    method : str
        Maximum likelihood on the raw samples (ml); the weak form, which gives its starting values, alone (weak); or the
        sparse regression of the paper (sindy).
    more : tuple[Path, ...]
        Another record of the same structure, read with the same options and fitted together with it (ml). Repeatable.
    """

    method: str = typed(type=click.Choice(list(METHODS)), default="ml", show_default=True)
    more: tuple[Path, ...] = typed("RECORD", "--with", multiple=True, type=FILE)


@click.command(
    cls=screen(
        *("mapping", "channel", "rate", "method", "more", "sensor", "input_noise", "admit", "profile"),
        *("output", "as_json"),
    )
)
@record_options
@click.argument("structure", type=STRUCTURE)
@grouped(FitOptions, "chosen")
@method_options(lw.MaximumLikelihood, "ml", remark=" (ml)")
@method_options(lw.PhysicsInformedSindy, "sindy", remark=" (sindy)")
@answer_options(RESULT, truth_option)
def identify(
    source: RecordOptions,
    structure: Path,
    chosen: FitOptions,
    ml: dict[str, Any],
    sindy: dict[str, Any],
    delivery: Delivery,
) -> int:
    """Identify the unknown coefficients of STRUCTURE from RECORD.

    Exit code 4 means that the laws leave more than noise and the intervals are approximate; 3 that the answer is refused. The
    table says why. Ctrl-C ends the search with the best result so far, which is refused.

    \b
    Examples:
      linkwise identify run.csv unknown.toml -o answer
      linkwise identify run.csv unknown.toml --mapping sensors.toml --with run2.csv
      linkwise identify run.csv unknown.toml --channel "x:m1[mm]=Laser 1" --sensor x:m1:offset
    \f
    \b
      linkwise identify run.csv unknown.toml --with run2.csv --sensor x:m1:offset --profile
      linkwise identify run.csv unknown.toml --mapping sensors.toml --decimate 4
      linkwise identify run.csv unknown.toml --calibration all=1% --sensor x:m1:offset=+-0.1mm,delay
      linkwise identify run.csv unknown.toml --sensor a:m1:drift --sensor x:m2:hum=50Hz,hum=100Hz
      linkwise identify run.csv unknown.toml --ambient all
      linkwise identify run.csv unknown.toml --input-noise force:m1=0.5
      linkwise identify run.csv unknown.toml --let offset,gain,delay
      linkwise identify run.csv unknown.toml --robust student --sensor x:m1:noise=0.1mm
      linkwise identify run.csv unknown.toml --exact
      linkwise identify run.csv unknown.toml --method sindy --regressor l1
    """
    estimator = _estimator(chosen, source, {"ml": ml, "sindy": sindy})
    subject = read_told(structure)
    true = None if delivery.truth is None else lw.read_structure(delivery.truth)
    if true is not None:
        link.refuse_memory(true.links, link.COMPARISON)
    note(*source.masses_beside(subject))
    with progress("reading") as step:
        paths = (source.record, *chosen.more)
        records = [replace(source, record=path).read_motion_of(subject) for path in paths]
        step(lw.estimates.ProgressReport(0.0, "identifying"))
        tests = records if len(records) > 1 else records[0]
        estimate = lw.identify(tests, subject, method=estimator, progress=step)
    title = "\nagainst the truth: NMSE of the force (paper Eq. 8)"
    errors = nmse_lines(lw.report.result_of(estimate, true), title)
    return delivery.of(estimate, more=errors, truth=true)


def _estimator(
    chosen: FitOptions, source: RecordOptions, given: dict[str, dict[str, Any]]
) -> lw.estimates.Estimator:
    """The method with its options; UsageError for those of another method."""
    further, method = stated({"more": chosen.more}), chosen.method
    for name, options in given.items():
        if name != method and (typed_options := {**(further if name == "ml" else {}), **options}):
            flag = option_name(next(iter(typed_options)))
            raise UsageError(f"{flag} is for --method {name}, not for {method}.")
    if method != "ml":
        source.refuse_unknown_errors()
    return METHODS.lookup(method)(**source.beside_errors(given.get(method, {})))


@click.command()
@record_options
@click.argument("structure", type=STRUCTURE)
@answer_options(COMPARISON)
def compare(source: RecordOptions, structure: Path, delivery: Delivery) -> int:
    """Identify the unknown coefficients of STRUCTURE from RECORD by maximum likelihood, the weak form and the sparse
    regression of the paper, and by maximum likelihood with the term or link that its diagnosis misses first.

    Shows coefficients with standard errors, grades, chi-square, the errors of free runs and times. A method that does not take
    the record, as sindy where the motion of a mass is not measured, says why. The exit code is that of the answer of maximum
    likelihood, as of identify.

    \b
    Examples:
      linkwise compare run.csv unknown.toml -o compared
      linkwise compare run.csv unknown.toml --mapping sensors.toml --json
    """
    source.refuse_unknown_errors()
    subject = read_told(structure)
    note(*source.masses_beside(subject))
    with progress("reading") as step:
        record = source.read_motion_of(subject)
        comparison = comparisons.compare(record, subject, progress=step)
    return delivery.of(comparison)
