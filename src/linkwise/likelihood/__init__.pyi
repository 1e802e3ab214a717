"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.likelihood.fisher_information import Precision as Precision
from linkwise.likelihood.optima.profiles import profile_interval as profile_interval
from linkwise.likelihood.shooting.loss import Gaussian as Gaussian
from linkwise.likelihood.shooting.loss import Huber as Huber
from linkwise.likelihood.shooting.loss import Loss as Loss
from linkwise.likelihood.shooting.loss import Student as Student
from linkwise.likelihood.shooting.minimise import AnnealingStep as AnnealingStep

__all__: list[str]
