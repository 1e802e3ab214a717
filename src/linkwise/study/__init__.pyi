"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.study.definition import Study as Study
from linkwise.study.definition import read_study as read_study
from linkwise.study.methods import StudyMethod as StudyMethod
from linkwise.study.runner import StudyProgress as StudyProgress
from linkwise.study.runner import run_study as run_study
from linkwise.study.store import read_rows as read_rows
from linkwise.study.store import stored_study as stored_study
from linkwise.study.subject import Case as Case
from linkwise.study.subject import MethodResult as MethodResult
from linkwise.study.subject import Row as Row
from linkwise.study.subject import Subject as Subject
from linkwise.study.summary import Cell as Cell
from linkwise.study.summary import StudySummary as StudySummary
from linkwise.study.summary import SuccessMap as SuccessMap
from linkwise.study.summary import export_study as export_study
from linkwise.study.summary import study_summary as study_summary
from linkwise.study.summary import success_maps as success_maps

__all__: list[str]
