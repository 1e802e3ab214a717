"""The result folder of `inspect`: numbers, figures and a page."""

from __future__ import annotations

from pathlib import Path

from linkwise.argument_types import checked
from linkwise.inspection.result import Inspection
from linkwise.progress import Progress, silent
from linkwise.report.inspection_page import inspection_page, inspection_sections
from linkwise.report.result_folder import ResultFolder


@checked
def write_inspection(inspection: Inspection, folder: str | Path, *, progress: Progress = silent) -> Path:
    """Write an inspection into a folder: inspection.json, figures of histories and spectra, and report.html.

    Parameters
    ----------
    inspection : Inspection
        What `inspect` returned.
    folder : path-like
        The folder. An earlier inspection in it is replaced when the new one is complete.
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
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> inspection = lw.inspect(record)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     written = lw.write_inspection(inspection, f"{folder}/inspection")
    ...     names = [path.name for path in written.iterdir()]
    >>> sorted(name for name in names if name.endswith((".json", ".html", ".toml")))
    ['inspection.json', 'report.html']
    """
    return INSPECTION_FOLDER.write(inspection, folder, progress=progress)


INSPECTION_FOLDER: ResultFolder[Inspection] = ResultFolder(
    mark="inspection.json",
    document=lambda inspection, truth: {"method": "inspect", **inspection.to_dict()},
    data=lambda reported, folder: None,
    figures=inspection_sections,
    page=inspection_page,
)
"""What `inspect` hands over."""
