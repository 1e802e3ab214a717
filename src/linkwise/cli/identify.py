"""`linkwise identify`: records and a structure with unknowns, to the force of every link."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

import linkwise as lw
from linkwise.cli.console import deliver, exit_code, progress, tell
from linkwise.cli.estimation_options import (
    DISTURBANCE_OPTIONS,
    random_force_options,
    refuse_foreign_calibration,
    refuse_foreign_disturbances,
    refuse_foreign_forces,
    sensor_options,
)
from linkwise.cli.options import (
    FILE,
    RegisteredChoice,
    folder_option,
    grouped,
    json_option,
    keyword_group,
    option_name,
    read_told,
    truth_option,
)
from linkwise.cli.reading_options import RecordOptions, record_options
from linkwise.identification.methods import METHODS
from linkwise.output import RESULT, to_json
from linkwise.registry import lazy_module
from linkwise.sindy.regression import REGRESSORS

if TYPE_CHECKING:
    from linkwise.model import link
    from linkwise.report import estimate as folders
else:
    link = lazy_module("linkwise.model.link")
    folders = lazy_module("linkwise.report.estimate")  # figures are for those who want a folder

# of an interval's half: from here a profile interval says something that a standard error does not
_DIFFERS = 0.1


@dataclass(frozen=True)
class MethodOptions:
    """By which method, from which records, as typed."""

    method: str
    more: tuple[Path, ...]
    profile: bool


def _loss(context: click.Context, option: click.Parameter, name: str | None) -> lw.likelihood.Loss | None:
    return {None: None, "huber": lw.likelihood.Huber(), "student": lw.likelihood.Student()}[name]


method_options = grouped(
    MethodOptions,
    "chosen",
    click.option(
        "--method",
        type=RegisteredChoice(METHODS),
        default="ml",
        show_default=True,
        help="Maximum likelihood on the raw samples (ml); the weak form, which gives its starting values, alone "
        "(weak); or the sparse regression of the paper (sindy).",
    ),
    click.option(
        "--with",
        "more",
        metavar="RECORD",
        multiple=True,
        type=FILE,
        help="Another record of the same structure, read with the same options and fitted together with it (ml). "
        "Repeatable.",
    ),
    click.option("--profile", is_flag=True, help="Also print profile-likelihood intervals (ml)."),
)

ml_options = keyword_group(
    "ml",
    *sensor_options(" (ml)"),
    *DISTURBANCE_OPTIONS,
    *random_force_options(" (ml)"),
    click.option(
        "--robust",
        "loss",
        type=click.Choice(["huber", "student"]),
        callback=_loss,
        help="Robust loss against outliers (ml; default none).",
    ),
    click.option(
        "--exact",
        is_flag=True,
        default=None,
        help="Take the laws as exact, without a model error: chi-square is that of a free run from the estimated "
        "initial state (ml).",
    ),
)

sindy_options = keyword_group(
    "sindy",
    click.option(
        "--derivative",
        type=click.Choice(["spline", "savgol", "differences"]),
        help="Method of differentiation (sindy; default spline).",
    ),
    click.option(
        "--regressor",
        type=RegisteredChoice(REGRESSORS),
        help="Regression method (sindy; default stlsq).",
    ),
)


@click.command()
@record_options
@click.argument("structure", type=FILE)
@method_options
@ml_options
@sindy_options
@folder_option(RESULT)
@truth_option
@json_option("result.json")
def identify(
    source: RecordOptions,
    structure: Path,
    chosen: MethodOptions,
    ml: dict[str, Any],
    sindy: dict[str, Any],
    output: Path | None,
    truth: Path | None,
    as_json: bool,
) -> int:
    """Identify the unknown coefficients of STRUCTURE from RECORD.

    Exit code 3 means that the answer is not to be trusted; the table says why. Ctrl-C ends the search with the best result so
    far, which is not to be trusted either.

    \b
    Examples:
      linkwise identify run.csv unknown.toml -o answer
      linkwise identify run.csv unknown.toml --with run2.csv --offset x:m1 --profile
      linkwise identify run.csv unknown.toml --mapping sensors.toml --decimate 4
      linkwise identify run.csv unknown.toml --calibration all=1% --offset x:m1=+-0.1mm
      linkwise identify run.csv unknown.toml --delay x:m2
      linkwise identify run.csv unknown.toml --drift a:m1 --hum x:m2=50
      linkwise identify run.csv unknown.toml --ambient all
      linkwise identify run.csv unknown.toml --input-noise force:m1=0.5
      linkwise identify run.csv unknown.toml --let offset,gain,delay
      linkwise identify run.csv unknown.toml --robust student --noise-of x:m1=1e-4
      linkwise identify run.csv unknown.toml --exact
      linkwise identify run.csv unknown.toml --method sindy --regressor l1
    """
    if source.errors_to_find and chosen.method != "ml":
        raise click.UsageError(f"{source.errors_to_find[0]} is for --method ml, not for {chosen.method}.")
    estimator = _estimator(chosen, ml, sindy)
    subject = read_told(structure)
    true = None if truth is None else lw.read_structure(truth)
    if true is not None:
        link.refuse_memory(true.links, link.COMPARISON)
    for remark in source.masses_beside(subject):
        tell(f"note: {remark}")
    with progress("reading") as step:
        records = [_read(replace(source, record=path), subject) for path in (source.record, *chosen.more)]
        refuse_foreign_calibration(ml.get("calibration", {}), records[0])
        refuse_foreign_disturbances(ml.get("drifts", {}), ml.get("hums", {}), records)
        refuse_foreign_forces(ml.get("ambient", {}), ml.get("input_noise", {}), records[0], subject)
        step(lw.estimates.ProgressReport(0.0, "identifying"))
        estimate = lw.identify(
            records[0] if len(records) == 1 else records,
            subject,
            method=estimator,
            progress=step,
        )
        profiles = _profiles(estimate, step) if chosen.profile else {}
    result = lw.report.result_of(estimate, true)
    if chosen.profile:
        result["profile_intervals"] = {name: list(ends) for name, ends in profiles.items()}
    lines = [str(estimate), *_profile_lines(estimate, profiles), *_comparison_lines(result)]
    deliver(
        to_json(result) if as_json else "\n".join(lines),
        estimate,
        output,
        lambda: folders.ESTIMATE_FOLDER,
        truth=true,
        quiet=as_json,
    )
    return exit_code(estimate.verdicts)


def _estimator(chosen: MethodOptions, ml: dict[str, Any], sindy: dict[str, Any]) -> lw.estimates.Estimator:
    """The method with its options; UsageError for those of another method."""
    general = {name: value for name, value in (("more", chosen.more), ("profile", chosen.profile)) if value}
    options = {"ml": ml, "sindy": sindy}
    for method, given in (("ml", {**general, **ml}), ("sindy", sindy)):
        if given and chosen.method != method:
            raise click.UsageError(
                f"{option_name(next(iter(given)))} is for --method {method}, not for {chosen.method}."
            )
    return METHODS.lookup(chosen.method)(**options.get(chosen.method, {}))


def _read(source: RecordOptions, subject: lw.Structure) -> lw.Record:
    record = source.read(tuple(dict.fromkeys((*subject.places, *subject.mass_names))))
    for note in record.notes:
        tell(f"note: {note}")
    return record


def _profiles(estimate: lw.Estimate, step: lw.estimates.Progress) -> dict[str, tuple[float, float]]:
    """Profile intervals of all unknowns that have one, with a note on those that have none; Ctrl-C leaves the rest out.

    Shapes of hosts, of which there are dozens, are left out.
    """
    intervals: dict[str, tuple[float, float]] = {}
    if not estimate.trusted:
        return intervals
    shapes = {shape.name for shape in estimate.shapes}
    names = [parameter.name for parameter in estimate.parameters if parameter.name not in shapes]
    if shapes:
        tell(f"note: the {len(shapes)} shapes of hosts get no profile intervals")
    try:
        for number, name in enumerate(names):
            step(lw.estimates.ProgressReport(number / len(names), f"profile of {name}"))
            try:
                intervals[name] = lw.likelihood.profile_interval(estimate, name)
            except lw.IdentificationError as error:
                tell(f"note: {error}")
    except KeyboardInterrupt:
        tell(f"note: interrupted; {len(names) - len(intervals)} profile intervals are left out")
    return intervals


def _profile_lines(estimate: lw.Estimate, profiles: dict[str, tuple[float, float]]) -> list[str]:
    """Profile intervals, marking those that differ from the intervals of the standard errors."""
    if not profiles:
        return []
    width = max(map(len, profiles))
    lines = ["\n95 % intervals that follow the likelihood (profiles)"]
    for name, ends in profiles.items():
        coefficient = estimate.coefficient(name)
        asymmetric = coefficient.interval is not None and any(
            abs(end - standard) > _DIFFERS * (coefficient.interval[1] - coefficient.value)
            for end, standard in zip(ends, coefficient.interval, strict=True)
        )
        mark = "  differs from the table: trust this one" if asymmetric else ""
        lines.append(f"  {name:{width}}  {ends[0]:.6g} to {ends[1]:.6g} {coefficient.unit}{mark}")
    return lines


def _comparison_lines(result: dict[str, Any]) -> list[str]:
    """How far each identified force is from the true one, where a truth was given."""
    if "nmse_percent" not in result:
        return []
    return [
        "\nagainst the truth: NMSE of the force (paper Eq. 8)",
        *(
            f"  {name:10} {'undefined' if error is None else f'{error:.3g} %'}"
            for name, error in result["nmse_percent"].items()
        ),
    ]
