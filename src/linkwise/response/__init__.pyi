"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.response.backbone import Backbone as Backbone
from linkwise.response.basins_of_attraction import Basins as Basins
from linkwise.response.basins_of_attraction import basins as basins
from linkwise.response.measured_points import MeasuredPoints as MeasuredPoints
from linkwise.response.options import Drive as Drive
from linkwise.response.options import ResponseOptions as ResponseOptions
from linkwise.response.result import Branch as Branch
from linkwise.response.result import Irregular as Irregular
from linkwise.response.result import Response as Response
from linkwise.response.result import ResponseLevel as ResponseLevel

__all__: list[str]
