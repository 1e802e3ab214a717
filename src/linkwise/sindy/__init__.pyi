"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.signals.states import States as States
from linkwise.signals.states import differentiate as differentiate
from linkwise.sindy.conventions import CONVENTIONS as CONVENTIONS
from linkwise.sindy.conventions import READINGS as READINGS
from linkwise.sindy.conventions import monomial_force as monomial_force
from linkwise.sindy.conventions import monomial_nmse as monomial_nmse
from linkwise.sindy.conventions import noisy_states as noisy_states
from linkwise.sindy.library import link_columns as link_columns
from linkwise.sindy.library import monomial_equations as monomial_equations
from linkwise.sindy.regression.linear_system import DenseSystem as DenseSystem
from linkwise.sindy.regression.linear_system import GramSums as GramSums
from linkwise.sindy.regression.linear_system import StreamedSystem as StreamedSystem
from linkwise.sindy.regression.regressor import L1 as L1
from linkwise.sindy.regression.regressor import LeastSquares as LeastSquares
from linkwise.sindy.regression.regressor import RegressionFit as RegressionFit
from linkwise.sindy.regression.regressor import Regressor as Regressor
from linkwise.sindy.regression.regressor import Stlsq as Stlsq
from linkwise.sindy.regression.regressor import SupportCandidate as SupportCandidate

__all__: list[str]
