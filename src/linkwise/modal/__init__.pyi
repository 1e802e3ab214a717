"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.identification.modal_test import HostEstimate as HostEstimate
from linkwise.identification.modal_test import identify_host as identify_host
from linkwise.model.host_file import read_modes as read_modes
from linkwise.model.matrix_files import read_host_matrices as read_host_matrices
from linkwise.model.matrix_files import read_matrix as read_matrix
from linkwise.model.reduction import HostMatrices as HostMatrices
from linkwise.model.reduction import HostReduction as HostReduction

__all__: list[str]
