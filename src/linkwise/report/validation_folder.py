"""The result folder of `validate`: numbers, the prediction, figures and a page."""

from __future__ import annotations

from pathlib import Path

from linkwise.argument_types import checked
from linkwise.files import write_record
from linkwise.identification.validation.result import Validation
from linkwise.model.toml_file import write_structure
from linkwise.output import VALIDATION
from linkwise.progress import Progress, silent
from linkwise.report.result_folder import ResultFolder
from linkwise.report.section import Reported, sections_of
from linkwise.report.validation_json import validation_of
from linkwise.report.validation_page import SECTIONS, validation_page


@checked
def write_validation(validation: Validation, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write a validation into a folder: validation.json, structure.toml, predicted.csv, figures and report.html.

    Parameters
    ----------
    validation : Validation
        What `validate` returned.
    folder : path-like
        The folder. An earlier result of `validate` in it is replaced when the new one is complete.
    progress : Progress
        Called with a `ProgressReport` before each figure.

    Returns
    -------
    pathlib.Path
        The folder.

    Raises
    ------
    OutputError
        If the folder holds something else, or cannot be written; then nothing is changed.

    Examples
    --------
    >>> import tempfile
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 0.1}, duration=0.5, rate=500.0).with_noise(40.0, seed=1)
    >>> result = lw.validate(record, chain)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.write_validation(result, f"{folder}/validation")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['report.html', 'structure.toml', 'validation.json']
    """
    return VALIDATION_FOLDER.write(validation, folder, progress=progress)


def _write_data(reported: Reported[Validation], folder: Path) -> None:
    """The structure, and the responses as it predicts them, empty where they are not scored."""
    write_structure(reported.result.structure, folder / "structure.toml")
    write_record(reported.result.predicted, folder / "predicted.csv")


VALIDATION_FOLDER: ResultFolder[Validation] = ResultFolder(
    mark=VALIDATION,
    document=lambda validation, _: validation_of(validation),
    data=_write_data,
    figures=lambda reported: sections_of(SECTIONS, reported),
    page=validation_page,
)
"""What `validate` hands over."""
