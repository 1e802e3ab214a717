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
from linkwise.public_names import HOMES

if TYPE_CHECKING:
    from linkwise.absorption.absorb import absorb
    from linkwise.absorption.intervals import AbsorptionIntervals, QuantityInterval, absorption_intervals
    from linkwise.absorption.map_result import AbsorptionMap, SweepAxis
    from linkwise.absorption.options import AbsorptionOptions
    from linkwise.absorption.quantities import AbsorptionQuantity
    from linkwise.absorption.result import Absorption
    from linkwise.absorption.result_parts import AbsorptionRun, Harvest, MassChange, MassDecay, SinkResult
    from linkwise.absorption.sinks import Sink
    from linkwise.absorption.sweep import absorption_map
    from linkwise.analysis.equilibria import Equilibria, Equilibrium, equilibria
    from linkwise.analysis.modes import Modes, modes
    from linkwise.analysis.wells import barrier, wells
    from linkwise.discovery.discover import check_discovery, discover
    from linkwise.discovery.memory_evidence import MemoryEvidence
    from linkwise.discovery.model_average import ModelAverage
    from linkwise.discovery.options import DiscoveryOptions
    from linkwise.discovery.other_models import PathPoint, RunnerUp
    from linkwise.discovery.result import Discovery, TermEvidence
    from linkwise.discovery.scoring import TermScore, align_truth, term_score
    from linkwise.discovery.terms import Term, parse_terms
    from linkwise.errors import (
        ArgumentTypeError,
        IdentificationError,
        LawError,
        LinkwiseError,
        OutputError,
        RecordError,
        SimulationError,
        StructureError,
        StudyError,
    )
    from linkwise.estimates.cause import Cause
    from linkwise.estimates.describing_function import Equivalent, equivalent
    from linkwise.estimates.estimate import Estimate
    from linkwise.estimates.estimator import Estimator
    from linkwise.estimates.link_estimate import CoefficientEstimate, DerivedQuantity, LinkEstimate
    from linkwise.estimates.link_motion import LinkMotion
    from linkwise.estimates.noise_estimate import NoiseEstimate
    from linkwise.estimates.random_force import RandomForceEstimate
    from linkwise.estimates.sensor_error import SensorErrorEstimate
    from linkwise.estimates.uncertainty import Posterior, read_posterior
    from linkwise.expression.tree import Expression
    from linkwise.files import read_record, write_record
    from linkwise.files.mapping import RecordMapping, read_mapping
    from linkwise.identification.force_error import nmse
    from linkwise.identification.identify import identify
    from linkwise.identification.law_path import LawStep, law_path
    from linkwise.identification.limit.limit import limit
    from linkwise.identification.limit.result import Limit, LinkLimit
    from linkwise.identification.modal_test.identify_host import identify_host
    from linkwise.identification.modal_test.result import HostEstimate
    from linkwise.identification.validation.free_run import FreeRun, free_run
    from linkwise.identification.validation.result import (
        ChannelPrediction,
        CoefficientAgreement,
        ErrorProfile,
        ErrorSpectrum,
        Validation,
    )
    from linkwise.identification.validation.validate import validate
    from linkwise.inspection.alert import Alert
    from linkwise.inspection.inspect import inspect
    from linkwise.inspection.levels.compare import compare_levels
    from linkwise.inspection.levels.distortion import Distortion
    from linkwise.inspection.levels.response_function import ResponseFunction
    from linkwise.inspection.levels.result import LevelComparison
    from linkwise.inspection.levels.ring_down import RingDown
    from linkwise.inspection.mark_missing import mark_missing
    from linkwise.inspection.result import ChannelSummary, Inspection
    from linkwise.likelihood.estimate import MaximumLikelihood
    from linkwise.likelihood.fisher_information import Precision
    from linkwise.likelihood.profile import profile_interval
    from linkwise.likelihood.shooting.anneal import AnnealingStep
    from linkwise.likelihood.shooting.loss import Gaussian, Huber, Loss, Student
    from linkwise.model.chains import bnes_chain
    from linkwise.model.excitation import Excitation, Impulse
    from linkwise.model.host import Host, HostMode
    from linkwise.model.host_reduction import HostReduction, reduce_host
    from linkwise.model.input_signal import PiecewisePolynomial, Sampled, TimeFunction
    from linkwise.model.law import Law, Partials
    from linkwise.model.link_state import LinkState, StateRate
    from linkwise.model.matrices import read_matrix
    from linkwise.model.named_law import LawText, NamedLaw
    from linkwise.model.named_laws import NAMED_LAWS, named_law
    from linkwise.model.parameters import Parameter
    from linkwise.model.structure import BASE, GROUND, Coefficient, Link, Mass, Structure
    from linkwise.model.toml_file import (
        PartialStructure,
        format_structure,
        parse_structure,
        read_partial_structure,
        read_structure,
        write_structure,
    )
    from linkwise.model.toml_host import read_modes
    from linkwise.model.topology import LinkShape, Topology
    from linkwise.progress import Progress, ProgressReport
    from linkwise.records.channel import Channel
    from linkwise.records.delays import without_delays
    from linkwise.records.joining import beside, continued, joined_by_time
    from linkwise.records.record import Record
    from linkwise.records.sensor_statement import SensorStatement, StatedError
    from linkwise.records.sensor_uncertainty import SensorUncertainty
    from linkwise.records.truth import EnergyBalance, MotionDiagnostics, SimulationTruth
    from linkwise.report.absorption_folder import write_absorption, write_absorption_map
    from linkwise.report.absorption_json import absorption_of
    from linkwise.report.discovery_folder import write_discovery
    from linkwise.report.discovery_json import discovery_of
    from linkwise.report.estimate_folder import write_result
    from linkwise.report.estimate_json import result_of
    from linkwise.report.export import export_answer
    from linkwise.report.inspection_folder import write_inspection
    from linkwise.report.study_folder import write_study_report
    from linkwise.report.validation_folder import write_validation
    from linkwise.report.validation_json import validation_of
    from linkwise.signals.periods import average_periods
    from linkwise.signals.states import States, differentiate
    from linkwise.simulation.envelope import OrbitEnvelope, orbit_envelope
    from linkwise.simulation.simulate import simulate
    from linkwise.sindy.conventions import CONVENTIONS, noisy_states
    from linkwise.sindy.estimate import PhysicsInformedSindy
    from linkwise.sindy.force_reading import READINGS, monomial_force, monomial_nmse
    from linkwise.sindy.library import link_columns, local_equations, monomial_equations
    from linkwise.sindy.regression.l1 import L1
    from linkwise.sindy.regression.least_squares import LeastSquares
    from linkwise.sindy.regression.linear_system import DenseSystem, StreamedSystem
    from linkwise.sindy.regression.regressor import RegressionFit, Regressor, SupportCandidate
    from linkwise.sindy.regression.stlsq import Stlsq
    from linkwise.study.cells import Cell
    from linkwise.study.definition import Study
    from linkwise.study.export import export_study
    from linkwise.study.method import MethodResult, StudyMethod
    from linkwise.study.row import Case, Row
    from linkwise.study.run import run_study
    from linkwise.study.runner import StudyProgress
    from linkwise.study.store import read_rows, stored_study
    from linkwise.study.subject import Subject
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
    "NAMED_LAWS",
    "READINGS",
    "Absorption",
    "AbsorptionIntervals",
    "AbsorptionMap",
    "AbsorptionOptions",
    "AbsorptionQuantity",
    "AbsorptionRun",
    "Alert",
    "AnnealingStep",
    "ArgumentTypeError",
    "Case",
    "Cause",
    "Cell",
    "Channel",
    "ChannelPrediction",
    "ChannelSummary",
    "Coefficient",
    "CoefficientAgreement",
    "CoefficientEstimate",
    "Decision",
    "DenseSystem",
    "DerivedQuantity",
    "Discovery",
    "DiscoveryOptions",
    "Distortion",
    "EnergyBalance",
    "Equilibria",
    "Equilibrium",
    "Equivalent",
    "ErrorProfile",
    "ErrorSpectrum",
    "Estimate",
    "Estimator",
    "Excitation",
    "Expression",
    "FreeRun",
    "Gaussian",
    "Harvest",
    "Host",
    "HostEstimate",
    "HostMode",
    "HostReduction",
    "Huber",
    "IdentificationError",
    "Impulse",
    "Inspection",
    "Law",
    "LawError",
    "LawStep",
    "LawText",
    "LeastSquares",
    "LevelComparison",
    "Limit",
    "Link",
    "LinkEstimate",
    "LinkLimit",
    "LinkMotion",
    "LinkShape",
    "LinkState",
    "LinkwiseError",
    "Loss",
    "Mass",
    "MassChange",
    "MassDecay",
    "MaximumLikelihood",
    "MemoryEvidence",
    "MethodResult",
    "ModelAverage",
    "Modes",
    "MotionDiagnostics",
    "NamedLaw",
    "NoiseEstimate",
    "OrbitEnvelope",
    "OutputError",
    "Parameter",
    "PartialStructure",
    "Partials",
    "PathPoint",
    "PhysicsInformedSindy",
    "PiecewisePolynomial",
    "Posterior",
    "Precision",
    "Progress",
    "ProgressReport",
    "QuantityInterval",
    "RandomForceEstimate",
    "Record",
    "RecordError",
    "RecordMapping",
    "RegressionFit",
    "Regressor",
    "ResponseFunction",
    "RingDown",
    "Row",
    "RunnerUp",
    "Sampled",
    "SensorErrorEstimate",
    "SensorStatement",
    "SensorUncertainty",
    "SimulationError",
    "SimulationTruth",
    "Sink",
    "SinkResult",
    "StateRate",
    "StatedError",
    "States",
    "Stlsq",
    "StreamedSystem",
    "Structure",
    "StructureError",
    "Student",
    "Study",
    "StudyError",
    "StudyMethod",
    "StudyProgress",
    "StudySummary",
    "Subject",
    "SupportCandidate",
    "SweepAxis",
    "Term",
    "TermEvidence",
    "TermScore",
    "TimeFunction",
    "Topology",
    "Validation",
    "Verdict",
    "WeakForm",
    "absorb",
    "absorption_intervals",
    "absorption_map",
    "absorption_of",
    "align_truth",
    "average_periods",
    "barrier",
    "beside",
    "bnes_chain",
    "check_discovery",
    "compare_levels",
    "continued",
    "differentiate",
    "discover",
    "discovery_of",
    "equilibria",
    "equivalent",
    "export_answer",
    "export_study",
    "format_structure",
    "free_run",
    "identify",
    "identify_host",
    "inspect",
    "joined_by_time",
    "law_path",
    "limit",
    "link_columns",
    "local_equations",
    "mark_missing",
    "modes",
    "monomial_equations",
    "monomial_force",
    "monomial_nmse",
    "named_law",
    "nmse",
    "noisy_states",
    "orbit_envelope",
    "parse_structure",
    "parse_terms",
    "plot",
    "profile_interval",
    "read_mapping",
    "read_matrix",
    "read_modes",
    "read_partial_structure",
    "read_posterior",
    "read_record",
    "read_rows",
    "read_structure",
    "read_study",
    "reduce_host",
    "result_of",
    "run_study",
    "simulate",
    "stored_study",
    "study_summary",
    "term_score",
    "to_si",
    "validate",
    "validation_of",
    "wells",
    "without_delays",
    "write_absorption",
    "write_absorption_map",
    "write_discovery",
    "write_inspection",
    "write_record",
    "write_result",
    "write_structure",
    "write_study_report",
    "write_validation",
]

_HOME = {name: home for home, names in HOMES.items() for name in names}

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
