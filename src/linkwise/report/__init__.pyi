"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.report.result_folder import result_of as result_of
from linkwise.report.result_folder import write_result as write_result
from linkwise.report.study import write_study_report as write_study_report

__all__: list[str]
