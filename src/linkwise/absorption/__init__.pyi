"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.absorption.absorb import AbsorptionOptions as AbsorptionOptions
from linkwise.absorption.design import Design as Design
from linkwise.absorption.design import DesignOptions as DesignOptions
from linkwise.absorption.ensemble import AbsorptionQuantity as AbsorptionQuantity
from linkwise.absorption.intervals import AbsorptionIntervals as AbsorptionIntervals
from linkwise.absorption.intervals import QuantityInterval as QuantityInterval
from linkwise.absorption.intervals import absorption_intervals as absorption_intervals
from linkwise.absorption.map import AbsorptionMap as AbsorptionMap
from linkwise.absorption.map import SweepAxis as SweepAxis
from linkwise.absorption.map import absorption_map as absorption_map
from linkwise.absorption.result import Harvest as Harvest
from linkwise.absorption.result import MassChange as MassChange
from linkwise.absorption.result import MassDecay as MassDecay
from linkwise.absorption.result import SinkResult as SinkResult
from linkwise.absorption.runs import AbsorptionRun as AbsorptionRun
from linkwise.absorption.search import DesignAxis as DesignAxis
from linkwise.absorption.sinks import Sink as Sink

__all__: list[str]
