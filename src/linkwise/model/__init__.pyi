"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.expression.tree import Expression as Expression
from linkwise.model.coefficient import Name as Name
from linkwise.model.excitation import Excitation as Excitation
from linkwise.model.excitation import Impulse as Impulse
from linkwise.model.excitation import PiecewisePolynomial as PiecewisePolynomial
from linkwise.model.excitation import Sampled as Sampled
from linkwise.model.excitation import TimeFunction as TimeFunction
from linkwise.model.host import HostMode as HostMode
from linkwise.model.law import LinkState as LinkState
from linkwise.model.law import Partials as Partials
from linkwise.model.law import StateRate as StateRate
from linkwise.model.named_laws import NAMED_LAWS as NAMED_LAWS
from linkwise.model.named_laws import NamedLaw as NamedLaw
from linkwise.model.named_laws import named_law as named_law
from linkwise.model.parameters import Parameter as Parameter
from linkwise.model.structure import BASE as BASE
from linkwise.model.structure import GROUND as GROUND
from linkwise.model.structure import LinkShape as LinkShape
from linkwise.model.structure import Topology as Topology
from linkwise.model.structure_file import PartialStructure as PartialStructure
from linkwise.model.structure_file import format_structure as format_structure
from linkwise.model.structure_file import read_partial_structure as read_partial_structure

__all__: list[str]
