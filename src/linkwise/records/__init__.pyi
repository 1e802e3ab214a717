"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.records.channel import Channel as Channel
from linkwise.records.channel import ClippedSamples as ClippedSamples
from linkwise.records.channel import SensorUncertainty as SensorUncertainty
from linkwise.records.joining import beside as beside
from linkwise.records.joining import continued as continued
from linkwise.records.joining import joined_by_time as joined_by_time
from linkwise.records.joining import without_delays as without_delays
from linkwise.records.period_average import average_periods as average_periods
from linkwise.records.record import EnergyBalance as EnergyBalance
from linkwise.records.record import MotionDiagnostics as MotionDiagnostics
from linkwise.records.record import SimulationTruth as SimulationTruth
from linkwise.records.sensor_statement import SensorStatement as SensorStatement
from linkwise.records.sensor_statement import StatedError as StatedError

__all__: list[str]
