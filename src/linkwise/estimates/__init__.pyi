"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.estimates.causes import Cause as Cause
from linkwise.estimates.causes import NoiseEstimate as NoiseEstimate
from linkwise.estimates.causes import RandomForceEstimate as RandomForceEstimate
from linkwise.estimates.causes import SensorErrorEstimate as SensorErrorEstimate
from linkwise.estimates.causes import UnseenTerm as UnseenTerm
from linkwise.estimates.curves import Equivalent as Equivalent
from linkwise.estimates.curves import equivalent as equivalent
from linkwise.estimates.estimate import Estimator as Estimator
from linkwise.estimates.link_estimate import CoefficientEstimate as CoefficientEstimate
from linkwise.estimates.link_estimate import DerivedQuantity as DerivedQuantity
from linkwise.estimates.link_estimate import LinkEstimate as LinkEstimate
from linkwise.estimates.link_estimate import LinkMotion as LinkMotion
from linkwise.estimates.uncertainty import Posterior as Posterior
from linkwise.estimates.uncertainty import read_posterior as read_posterior
from linkwise.identification.limit_result import LinkLimit as LinkLimit
from linkwise.identification.validation_result import ChannelPrediction as ChannelPrediction
from linkwise.identification.validation_result import CoefficientAgreement as CoefficientAgreement
from linkwise.identification.validation_result import ErrorProfile as ErrorProfile
from linkwise.identification.validation_result import ErrorSpectrum as ErrorSpectrum
from linkwise.progress import Progress as Progress
from linkwise.progress import ProgressReport as ProgressReport

__all__: list[str]
from linkwise.verdict import Basis as Basis
