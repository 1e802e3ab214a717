"""What a command hands over in a folder: a document, data files, figures and a page."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, TypeVar

from markupsafe import Markup

from linkwise.model.structure import Structure
from linkwise.output import RESULT, atomic_folder, check_result_folder, to_json
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.report.drawing_process import DrawingProcess, Picture
from linkwise.report.section import Reported, Section, drawings, write_figures

R = TypeVar("R")


@dataclass(frozen=True, kw_only=True)
class ResultFolder(Generic[R]):
    """One kind of result folder, for results of one type.

    Parameters
    ----------
    document
        What the JSON file says of a result, with the key "method", and beside the true structure "nmse_percent" where one is
        given. The names of the files are added to it.
    data
        Writes the files beside it, figures and page aside, into an empty folder.
    figures
        The sections with figures, by the name of their files.
    page
        The page as text, from the figures as `write_figures` returns them.
    mark
        The name of the JSON file, which marks the folder as one of this kind.
    shown
        What is written of a result; by default the result as it is.
    """

    document: Callable[[R, Structure | None], dict[str, Any]]
    data: Callable[[Reported[R], Path], None]
    figures: Callable[[Reported[R]], Mapping[str, Section]]
    page: Callable[[Reported[R], Mapping[str, Markup]], str]
    mark: str = RESULT
    shown: Callable[[R], R] = lambda result: result

    def check(self, folder: str | Path) -> None:
        """Raise OutputError where `write` would, before the work that leads to a result."""
        check_result_folder(Path(folder), self.mark)

    def write(
        self,
        result: R,
        folder: str | Path,
        *,
        truth: Structure | None = None,
        progress: Progress = silent,
        process: DrawingProcess | None = None,
    ) -> Path:
        """Write everything or nothing; returns the folder.

        An earlier result of this kind is replaced when the new one is complete. A `process` that draws the same result takes
        its part of the figures. Raises OutputError for a folder that holds something else.
        """
        document, reported = self._reported(result, truth)
        with atomic_folder(Path(folder), self.mark) as partial:
            self.data(reported, partial)
            sections = self.figures(reported)
            pictures = write_figures(sections, partial, part(progress, 0.0, 0.9), process)
            progress(ProgressReport(0.9, "page"))
            (partial / "report.html").write_text(self.page(reported, pictures), encoding="utf-8")
            self._conclude(document, partial)
        return Path(folder)

    def write_numbers(self, result: R, folder: str | Path, *, truth: Structure | None = None) -> Path:
        """Write the document and the data, without figures and page, as `write` does; returns the folder."""
        document, reported = self._reported(result, truth)
        with atomic_folder(Path(folder), self.mark) as partial:
            self.data(reported, partial)
            self._conclude(document, partial)
        return Path(folder)

    def _conclude(self, document: dict[str, Any], folder: Path) -> None:
        """Write the document, which marks the folder as complete, with the names of the files that are there."""
        files = sorted(path.name for path in folder.iterdir())
        text = to_json({**document, "files": files}, indent=1) + "\n"
        (folder / self.mark).write_text(text, encoding="utf-8")

    def drawings(self, result: R, truth: Structure | None = None) -> dict[str, Callable[[], Picture]]:
        """What draws the figures of a result, by the name of their files."""
        return drawings(self.figures(self._reported(result, truth)[1]))

    def _reported(self, result: R, truth: Structure | None) -> tuple[dict[str, Any], Reported[R]]:
        """The document, and what figures and pages are made of."""
        shown = self.shown(result)
        document = self.document(shown, truth)
        return document, Reported(shown, truth, document.get("nmse_percent", {}))
