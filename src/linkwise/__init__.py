"""linkwise identifies nonlinear structures link by link: from a record to the force law of every link.

Names load on first use (PEP 562), so `import linkwise` costs next to nothing and a script pays only for
what it touches.
"""

from __future__ import annotations

import sys
from importlib import import_module
from operator import attrgetter
from typing import TYPE_CHECKING

from linkwise import plot
from linkwise.deprecation import Deprecated

if TYPE_CHECKING:
    from linkwise.absorption.absorb import absorb
    from linkwise.absorption.intervals import AbsorptionIntervals, absorption_intervals
    from linkwise.absorption.map_result import AbsorptionMap
    from linkwise.absorption.options import AbsorptionOptions
    from linkwise.absorption.result import Absorption
    from linkwise.absorption.sweep import absorption_map
    from linkwise.analysis.equilibria import Equilibrium, equilibria
    from linkwise.analysis.modes import modes
    from linkwise.analysis.wells import barrier, wells
    from linkwise.discovery.discover import check_discovery, discover
    from linkwise.discovery.result import Discovery
    from linkwise.discovery.scoring import TermScore, align_truth, term_score
    from linkwise.discovery.terms import parse_terms
    from linkwise.errors import (
        IdentificationError,
        LawError,
        LinkwiseError,
        RecordError,
        SimulationError,
        StructureError,
        StudyError,
    )
    from linkwise.estimates.describing_function import Equivalent, equivalent
    from linkwise.estimates.estimate import Estimate
    from linkwise.estimates.estimator import Estimator
    from linkwise.estimates.uncertainty import Posterior, read_posterior
    from linkwise.files import read_record, write_record
    from linkwise.identification.force_error import nmse
    from linkwise.identification.identify import identify
    from linkwise.identification.law_path import LawStep, law_path
    from linkwise.identification.limit import limit
    from linkwise.identification.limit_result import Limit
    from linkwise.identification.validation import FreeRun, free_run
    from linkwise.likelihood.anneal import AnnealingStep
    from linkwise.likelihood.estimate import MaximumLikelihood
    from linkwise.likelihood.loss import Gaussian, Huber, Loss, Student
    from linkwise.likelihood.profile import profile_interval
    from linkwise.model.chains import bnes_chain
    from linkwise.model.excitation import Excitation, Impulse
    from linkwise.model.input_signal import Sampled, TimeFunction
    from linkwise.model.law import Law
    from linkwise.model.structure import BASE, GROUND, Coefficient, Link, Mass, Structure
    from linkwise.model.toml_file import (
        PartialStructure,
        format_structure,
        parse_structure,
        read_partial_structure,
        read_structure,
        write_structure,
    )
    from linkwise.progress import Progress, ProgressReport
    from linkwise.records.record import Record
    from linkwise.report.absorption_folder import write_absorption, write_absorption_map
    from linkwise.report.absorption_json import absorption_of
    from linkwise.report.discovery_folder import write_discovery
    from linkwise.report.discovery_json import discovery_of
    from linkwise.report.estimate_folder import write_result
    from linkwise.report.estimate_json import result_of
    from linkwise.report.study_folder import write_study_report
    from linkwise.signals.states import differentiate
    from linkwise.simulation.simulate import simulate
    from linkwise.sindy.conventions import CONVENTIONS, noisy_states
    from linkwise.sindy.estimate import PhysicsInformedSindy
    from linkwise.sindy.force_reading import READINGS, monomial_force, monomial_nmse
    from linkwise.sindy.library import link_columns, local_equations, monomial_equations
    from linkwise.sindy.regression.l1 import L1
    from linkwise.sindy.regression.least_squares import LeastSquares
    from linkwise.sindy.regression.stlsq import Stlsq
    from linkwise.study.definition import Study
    from linkwise.study.export import export_study
    from linkwise.study.row import Row
    from linkwise.study.run import run_study
    from linkwise.study.runner import StudyProgress
    from linkwise.study.store import read_rows, stored_study
    from linkwise.study.summary import StudySummary, study_summary
    from linkwise.study.toml_file import read_study
    from linkwise.units import to_si
    from linkwise.verdict import Decision, Verdict
    from linkwise.weak.estimate import WeakForm

__version__ = "0.2.0"

__all__ = [
    "BASE",
    "CONVENTIONS",
    "GROUND",
    "L1",
    "READINGS",
    "Absorption",
    "AbsorptionIntervals",
    "AbsorptionMap",
    "AbsorptionOptions",
    "AnnealingStep",
    "Coefficient",
    "Decision",
    "Discovery",
    "Equilibrium",
    "Equivalent",
    "Estimate",
    "Estimator",
    "Excitation",
    "FreeRun",
    "Gaussian",
    "Huber",
    "IdentificationError",
    "Impulse",
    "Law",
    "LawError",
    "LawStep",
    "LeastSquares",
    "Limit",
    "Link",
    "LinkwiseError",
    "Loss",
    "Mass",
    "MaximumLikelihood",
    "PartialStructure",
    "PhysicsInformedSindy",
    "Posterior",
    "Progress",
    "ProgressReport",
    "Record",
    "RecordError",
    "Row",
    "Sampled",
    "SimulationError",
    "Stlsq",
    "Structure",
    "StructureError",
    "Student",
    "Study",
    "StudyError",
    "StudyProgress",
    "StudySummary",
    "TermScore",
    "TimeFunction",
    "Verdict",
    "WeakForm",
    "absorb",
    "absorption_intervals",
    "absorption_map",
    "absorption_of",
    "align_truth",
    "barrier",
    "bnes_chain",
    "check_discovery",
    "differentiate",
    "discover",
    "discovery_of",
    "equilibria",
    "equivalent",
    "export_study",
    "format_structure",
    "free_run",
    "identify",
    "law_path",
    "limit",
    "link_columns",
    "local_equations",
    "modes",
    "monomial_equations",
    "monomial_force",
    "monomial_nmse",
    "nmse",
    "noisy_states",
    "parse_structure",
    "parse_terms",
    "plot",
    "profile_interval",
    "read_partial_structure",
    "read_posterior",
    "read_record",
    "read_rows",
    "read_structure",
    "read_study",
    "result_of",
    "run_study",
    "simulate",
    "stored_study",
    "study_summary",
    "term_score",
    "to_si",
    "wells",
    "write_absorption",
    "write_absorption_map",
    "write_discovery",
    "write_record",
    "write_result",
    "write_structure",
    "write_study_report",
]

# The module that each name lives in; a test keeps it equal to the imports that only type checkers see.
_HOMES = {
    "absorption.absorb": ("absorb",),
    "report.absorption_folder": ("write_absorption", "write_absorption_map"),
    "report.absorption_json": ("absorption_of",),
    "absorption.intervals": ("AbsorptionIntervals", "absorption_intervals"),
    "estimates.uncertainty": ("Posterior", "read_posterior"),
    "absorption.options": ("AbsorptionOptions",),
    "absorption.result": ("Absorption",),
    "absorption.map_result": ("AbsorptionMap",),
    "absorption.sweep": ("absorption_map",),
    "report.estimate_folder": ("write_result",),
    "report.estimate_json": ("result_of",),
    "identification.limit_result": ("Limit",),
    "model.chains": ("bnes_chain",),
    "sindy.estimate": ("PhysicsInformedSindy",),
    "sindy.conventions": ("CONVENTIONS", "noisy_states"),
    "signals.states": ("differentiate",),
    "estimates.describing_function": ("Equivalent", "equivalent"),
    "discovery.discover": ("check_discovery", "discover"),
    "report.discovery_folder": ("write_discovery",),
    "report.discovery_json": ("discovery_of",),
    "discovery.result": ("Discovery",),
    "discovery.terms": ("parse_terms",),
    "discovery.scoring": ("TermScore", "align_truth", "term_score"),
    "analysis.equilibria": ("Equilibrium", "equilibria"),
    "errors": (
        "IdentificationError",
        "LawError",
        "LinkwiseError",
        "RecordError",
        "SimulationError",
        "StructureError",
        "StudyError",
    ),
    "estimates.estimator": ("Estimator",),
    "estimates.estimate": ("Estimate",),
    "model.excitation": ("Excitation", "Impulse"),
    "model.input_signal": ("Sampled", "TimeFunction"),
    "files": ("read_record", "write_record"),
    "identification.identify": ("identify",),
    "model.law": ("Law",),
    "sindy.library": ("link_columns", "local_equations", "monomial_equations"),
    "likelihood.anneal": ("AnnealingStep",),
    "likelihood.estimate": ("MaximumLikelihood",),
    "likelihood.loss": ("Gaussian", "Huber", "Loss", "Student"),
    "likelihood.profile": ("profile_interval",),
    "identification.limit": ("limit",),
    "identification.law_path": ("LawStep", "law_path"),
    "analysis.modes": ("modes",),
    "sindy.force_reading": ("READINGS", "monomial_force", "monomial_nmse"),
    "progress": ("Progress", "ProgressReport"),
    "records.record": ("Record",),
    "report.study_folder": ("write_study_report",),
    "simulation.simulate": ("simulate",),
    "sindy.regression.l1": ("L1",),
    "sindy.regression.least_squares": ("LeastSquares",),
    "sindy.regression.stlsq": ("Stlsq",),
    "model.structure": ("BASE", "GROUND", "Coefficient", "Link", "Mass", "Structure"),
    "model.toml_file": (
        "PartialStructure",
        "format_structure",
        "parse_structure",
        "read_partial_structure",
        "read_structure",
        "write_structure",
    ),
    "study.run": ("run_study",),
    "study.runner": ("StudyProgress",),
    "study.definition": ("Study",),
    "study.export": ("export_study",),
    "study.row": ("Row",),
    "study.store": ("read_rows", "stored_study"),
    "study.toml_file": ("read_study",),
    "study.summary": ("StudySummary", "study_summary"),
    "weak.estimate": ("WeakForm",),
    "units": ("to_si",),
    "identification.force_error": ("nmse",),
    "identification.validation": ("FreeRun", "free_run"),
    "verdict": ("Decision", "Verdict"),
    "analysis.wells": ("barrier", "wells"),
}
_HOME = {name: home for home, names in _HOMES.items() for name in names}

# Old spellings of public names; they warn and are not listed by dir(). CONTRIBUTING.md says when one may go.
_DEPRECATED = {
    "Classical": Deprecated("PhysicsInformedSindy", since="0.2.0", until="0.4.0"),
    "Known": Deprecated("PartialStructure", since="0.2.0", until="0.4.0"),
    "Knowledge": Deprecated("Posterior", since="0.2.0", until="0.4.0"),
    "foreseen": Deprecated("check_discovery", since="0.2.0", until="0.4.0"),
    "read_known": Deprecated("read_partial_structure", since="0.2.0", until="0.4.0"),
    "read_knowledge": Deprecated("read_posterior", since="0.2.0", until="0.4.0"),
    "truth_beside": Deprecated("align_truth", since="0.2.0", until="0.4.0"),
}


def __getattr__(name: str) -> object:
    if name in _DEPRECATED:
        new = _DEPRECATED[name].new
        _DEPRECATED[name].warn(f"linkwise.{name}", f"linkwise.{new}")
        return attrgetter(new)(sys.modules[__name__])
    if name not in _HOME:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*__all__, "__version__"])
