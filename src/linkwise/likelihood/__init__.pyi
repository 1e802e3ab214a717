"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.likelihood.fisher_information import Precision as Precision
from linkwise.likelihood.optima.profiles import profile_interval as profile_interval
from linkwise.likelihood.shooting.minimise import AnnealingStep as AnnealingStep
from linkwise.likelihood.shooting.residuals import Gaussian as Gaussian
from linkwise.likelihood.shooting.residuals import Huber as Huber
from linkwise.likelihood.shooting.residuals import Loss as Loss
from linkwise.likelihood.shooting.residuals import Student as Student

__all__: list[str]
