"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.analysis.linear_modes import Modes as Modes
from linkwise.analysis.linear_modes import modes as modes
from linkwise.analysis.potential_wells import barrier as barrier
from linkwise.analysis.potential_wells import wells as wells
from linkwise.analysis.rest_positions import Equilibria as Equilibria
from linkwise.analysis.rest_positions import Equilibrium as Equilibrium
from linkwise.analysis.rest_positions import equilibria as equilibria
from linkwise.identification.best_test import BestTest as BestTest
from linkwise.identification.best_test import Plan as Plan
from linkwise.identification.limit_result import Limit as Limit
from linkwise.identification.prediction import FreeRun as FreeRun
from linkwise.identification.prediction import free_run as free_run
from linkwise.simulation.simulate import OrbitEnvelope as OrbitEnvelope
from linkwise.simulation.simulate import orbit_envelope as orbit_envelope

__all__: list[str]
