"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.report.absorption import absorption_of as absorption_of
from linkwise.report.absorption import write_absorption as write_absorption
from linkwise.report.absorption import write_absorption_map as write_absorption_map
from linkwise.report.design import design_of as design_of
from linkwise.report.design import write_design as write_design
from linkwise.report.discovery import discovery_of as discovery_of
from linkwise.report.discovery import write_discovery as write_discovery
from linkwise.report.estimate import result_of as result_of
from linkwise.report.estimate import write_result as write_result
from linkwise.report.inspection import write_inspection as write_inspection
from linkwise.report.response import backbone_of as backbone_of
from linkwise.report.response import response_of as response_of
from linkwise.report.response import write_backbone as write_backbone
from linkwise.report.response import write_response as write_response
from linkwise.report.study import write_study_report as write_study_report
from linkwise.report.validation import validation_of as validation_of
from linkwise.report.validation import write_validation as write_validation

__all__: list[str]
