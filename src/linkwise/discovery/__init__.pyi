"""The public names, one a line; `__init__.py` reads the module of each from here (`linkwise.registry`)."""

from linkwise.discovery.candidates import DiscoveryOptions as DiscoveryOptions
from linkwise.discovery.discover import check_discovery as check_discovery
from linkwise.discovery.model_average import ModelAverage as ModelAverage
from linkwise.discovery.result import MemoryEvidence as MemoryEvidence
from linkwise.discovery.result import PathPoint as PathPoint
from linkwise.discovery.result import RunnerUp as RunnerUp
from linkwise.discovery.result import TermEvidence as TermEvidence
from linkwise.discovery.terms import Term as Term
from linkwise.discovery.terms import parse_terms as parse_terms
from linkwise.estimates.scoring import TermScore as TermScore
from linkwise.estimates.scoring import align_truth as align_truth
from linkwise.estimates.scoring import term_score as term_score
from linkwise.verdict import Decision as Decision

__all__: list[str]
