"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.inspection.inspect import EstimatedError as EstimatedError
from linkwise.inspection.inspect import mark_missing as mark_missing
from linkwise.inspection.level_comparison import LevelComparison as LevelComparison
from linkwise.inspection.level_comparison import compare_levels as compare_levels
from linkwise.inspection.level_quantities import AccelerationSurface as AccelerationSurface
from linkwise.inspection.level_quantities import BridgedGaps as BridgedGaps
from linkwise.inspection.level_quantities import Distortion as Distortion
from linkwise.inspection.level_quantities import ResponseFunction as ResponseFunction
from linkwise.inspection.level_quantities import RingDown as RingDown
from linkwise.inspection.result import Alert as Alert
from linkwise.inspection.result import ChannelSummary as ChannelSummary
from linkwise.inspection.result import Inspection as Inspection

__all__: list[str]
