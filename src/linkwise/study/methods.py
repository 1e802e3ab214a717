"""The methods of a study: identification of coefficients, discovery, and sparse regression, the paper's own among it."""

from __future__ import annotations

import warnings
from abc import abstractmethod
from functools import lru_cache
from importlib import import_module
from time import perf_counter
from typing import Annotated, Any, ClassVar, Literal, final

import msgspec
import numpy as np

from linkwise.arrays import Floats
from linkwise.discovery.candidates import DiscoveryOptions, candidates_for
from linkwise.discovery.discover import discover
from linkwise.discovery.terms import DEFAULT, parse_terms
from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimator
from linkwise.estimates.scoring import align_truth, term_score
from linkwise.expression import Expression, Number, Symbol, add, multiply, polynomial, substitute
from linkwise.identification.identify import IdentificationMethod, identify, nmse
from linkwise.model.law import VARIABLES, Law
from linkwise.model.link import BASE, GROUND, LENGTH, Link, refuse_memory
from linkwise.model.structure import Structure, refuse_hosts, refuse_rig
from linkwise.records.record import Record
from linkwise.signals.states import DifferentiationMethod as Derivative
from linkwise.signals.states import differentiate
from linkwise.sindy.conventions import Convention, Reading, monomial_force, monomial_nmse, noisy_states
from linkwise.sindy.estimate import MAX_UNEXPLAINED, PhysicsInformedSindy
from linkwise.sindy.library import Monomials, link_columns, monomial_equations, tags
from linkwise.sindy.regression import REGRESSORS
from linkwise.sindy.regression.gram import Gram
from linkwise.sindy.regression.linear_system import StreamedSystem
from linkwise.sindy.regression.regressor import RegressionFit, Regressor
from linkwise.study.subject import MethodResult, Subject
from linkwise.verdict import Grade, Verdict, status_of


class StudyMethod(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A method of a study; its fields are the keys of its table in a study file.

    Attributes
    ----------
    name : str
        Its name in the study; by default the kind of method.
    looks_for_terms : bool
        Whether it is not told the terms, and its answers are judged by them.

    Examples
    --------
    >>> import linkwise as lw
    >>> method = lw.study.read_study("paper").method("physics-informed")
    >>> isinstance(method, lw.study.StudyMethod), method.document()["kind"]
    (True, 'physics-informed')
    """

    name: str = ""
    looks_for_terms: ClassVar[bool] = False

    def __post_init__(self) -> None:
        if not self.name:
            msgspec.structs.force_setattr(self, "name", self.usual_name)

    @property
    def usual_name(self) -> str:
        """The name where none is given."""
        return str(getattr(self, "kind", type(self).__name__))

    @abstractmethod
    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        """Add noise to a record, identify the structure from it, and compare the result with the truth.

        Parameters
        ----------
        subject : Subject
            The structure, with what is measured, unknown and judged.
        clean : Record
            A record of it without noise.
        snr_db : float
            The signal-to-noise ratio in dB of the noise that is added.
        seed : int
            The seed of the noise.

        Returns
        -------
        MethodResult
            Errors of the forces, and the coefficients.

        Raises
        ------
        LinkwiseError
            If nothing can be identified.
        """

    def document(self) -> dict[str, Any]:
        """The table of a study file that defines this method.

        Returns
        -------
        dict
            Plain data, with the keys "name" and "kind" and the options of the method.
        """
        return {key: value for key, value in msgspec.to_builtins(self).items() if value is not None}


@final
class LinkByLink(StudyMethod, frozen=True, kw_only=True):
    """Maximum likelihood or the weak form (METHODS sections 5 and 4)."""

    kind: Literal["ml", "weak"]

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, self.kind)


@final
class PhysicsInformedMethod(StudyMethod, frozen=True):
    """The paper's physics-informed SINDy: derivatives, the columns of the links' own laws, sparse regression."""

    derivative: Derivative = "spline"
    regressor: str = "stlsq"
    kind: Literal["physics-informed"] = "physics-informed"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        PhysicsInformedSindy(self.derivative, self.regressor)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        return _identify(subject, clean, snr_db, seed, PhysicsInformedSindy(self.derivative, self.regressor))


def _identify(
    subject: Subject, clean: Record, snr_db: float, seed: int, estimator: IdentificationMethod | Estimator
) -> MethodResult:
    record = subject.measured(clean).with_noise(snr_db, seed=seed)
    estimate = identify(record, subject.stated_structure(seed), method=estimator)
    names = [parameter.name for parameter in estimate.parameters]
    errors = np.sqrt(np.maximum(estimate.covariance.diagonal(), 0.0)).tolist()
    true, identified = subject.true_structure, estimate.structure
    return MethodResult(
        status=estimate.status,
        seconds=estimate.seconds,
        links={name: nmse(true.link(name), identified.link(name), clean) for name in subject.judged_links},
        coefficients=dict(zip(names, map(float, estimate.values), strict=True)),
        standard_errors={} if estimate.grade is Grade.REFUSED else dict(zip(names, errors, strict=False)),
        reason="" if estimate.trusted else estimate.explanation,
    )


_NO_FORCE = Law.parse("0")


def judged(structure: Structure, subject: Subject, clean: Record) -> tuple[dict[str, float], dict[str, int]]:
    """The errors of links in % and the numbers of terms of a structure, every coefficient a number, against the true one
    along its motion `clean`.

    The NMSE of a true link is that of the link between the same ends, 100 % and more where there is none.
    """
    truth = subject.true_structure
    score = term_score(structure, truth)
    aligned, links = align_truth(structure, truth), {}
    by_ends = {frozenset(link.between): link for link in reversed(structure.links)}
    for name in subject.judged_links:
        true = truth.link(name)
        link = by_ends.get(frozenset(true.between))
        true = true if link is None else aligned.link(link.name)
        links[name] = nmse(true, link or Link(name, true.between, _NO_FORCE, {}), clean)
    return links, {name: len(getattr(score, name)) for name in ("right", "missing", "extra")}


def masses_alone(subject: Subject, method: str) -> dict[str, float | str]:
    """The masses by name, in kg or, of what turns, with their unit: all that a `method` that looks for links is told.

    Raises IdentificationError for a structure of another kind than masses on links.
    """
    structure = subject.true_structure
    refuse_rig(structure, method)
    refuse_memory(structure.links, method, "maximum likelihood takes it")
    refuse_hosts(structure, method)
    values = zip(structure.masses, structure.mass_values.tolist(), strict=True)
    return {m.name: value if m.unit == LENGTH else f"{value!r} {m.mass_unit}" for m, value in values}


@final
class DiscoveryMethod(StudyMethod, frozen=True):
    """`discover` with candidate `terms` on every link (METHODS section 9).

    It is told the masses and nothing of links; what is `unknown` of a structure does not matter. Coefficients of its rows are
    those of the discovered structure, by its own names. Raises IdentificationError for terms that are no candidates.
    """

    looks_for_terms: ClassVar[bool] = True

    terms: str = DEFAULT
    kind: Literal["discover"] = "discover"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        DiscoveryOptions(terms=self.terms)

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses = masses_alone(subject, 'methods of the kind "discover"')
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        discovery = discover(record, masses, terms=self.terms)
        links, terms = judged(discovery.structure, subject, clean)
        values = [(link.name, *entry) for link in discovery.structure.links for entry in link.values.items()]
        return MethodResult(
            status=status_of(discovery.verdicts),
            seconds=discovery.seconds,
            links=links,
            coefficients={f"{link}.{name}": float(value) for link, name, value in values},
            reason=next((verdict.value for verdict in discovery.verdicts if verdict.forbids), ""),
            terms=terms,
        )


Order = Annotated[int, msgspec.Meta(ge=1)]
Threshold = Annotated[float, msgspec.Meta(ge=0, lt=1)]


@final
class MonomialMethod(StudyMethod, frozen=True, kw_only=True):
    """Noise added as the `convention` says, all monomials up to `order`, a regressor, and a `reading` of the force.

    `regressor` is a name in `REGRESSORS`; `threshold` is that of "stlsq", None for the one of smallest BIC. Methods that
    differ in regressor or reading share the Gram matrix of a case; its time counts for each of them. Only the equations of
    masses with a single link are solved: others do not separate the forces of links. Raises IdentificationError for an unknown
    regressor, and for a threshold of one that has none.
    """

    convention: Convention
    regressor: str = "least-squares"
    reading: Reading = "coefficients"
    order: Order = 3
    threshold: Threshold | None = None
    kind: Literal["monomial"] = "monomial"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        _regressor(self.regressor, self.threshold)

    @property
    def usual_name(self) -> str:
        return f"{self.kind}, {self.convention}"

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses_alone(subject, 'methods of the kind "monomial"')
        structure = subject.structure
        equations, gram, seconds = _gram_of_case(clean, self.convention, snr_db, seed, self.order)
        started = perf_counter()
        named = dict(zip(structure.mass_names, tags(structure.mass_names), strict=True))
        ends = [end for link in structure.links for end in link.between]  # an equation has a single link
        targets = tuple(f"x{tag}''" for mass, tag in named.items() if ends.count(mass) == 1)
        fit = _fit(equations, gram, targets, _regressor(self.regressor, self.threshold))
        seconds += perf_counter() - started
        links, coefficients = {}, {}
        for name in subject.judged_links:
            links[name] = monomial_nmse(fit, structure, name, clean, reading=self.reading)
            d, force = monomial_force(fit, structure, name, clean, reading=self.reading)
            coefficients.update(_fitted_coefficients(structure.link(name), d, force))
        status = Verdict.CONVERGED.status
        return MethodResult(status=status, seconds=seconds, links=links, coefficients=coefficients)


@lru_cache(maxsize=1)
def _gram_of_case(
    clean: Record, convention: Convention, snr_db: float, seed: int, order: int
) -> tuple[StreamedSystem, Gram, float]:
    """The equations of a case, their Gram matrix and the time in s that it took; the last one is cached."""
    states = noisy_states(clean, convention, snr_db, seed=seed)
    started = perf_counter()
    equations = monomial_equations(states, order)
    gram = Gram.of(equations)
    return equations, gram, perf_counter() - started


def _fit(
    equations: StreamedSystem, gram: Gram, targets: tuple[str, ...], regressor: Regressor
) -> RegressionFit:
    """The equations of some targets, without standard errors: the inverse of 1771 columns takes longer than all else."""
    columns = [equations.targets.index(target) for target in targets]
    return regressor.fit_gram(gram, equations.units, targets, columns=columns, errors=False)


def _regressor(name: str, threshold: float | None) -> Regressor:
    regressor = REGRESSORS.lookup(name)()
    return regressor if threshold is None else regressor.with_threshold(threshold)


def _fitted_coefficients(link: Link, d: Floats, force: Floats) -> dict[str, float]:
    """The stiffness coefficients of a polynomial law that fit a force (N,) N at elongations `d` (N,) m.

    None for another law.
    """
    if polynomial(link.law.elastic, ("d",)) is None:
        return {}
    partials = link.law.partials(d, np.zeros_like(d), link.values).by_coefficient
    columns = {name: values for name, values in partials.items() if np.any(values)}
    matrix = np.column_stack(list(columns.values()))
    sizes = np.linalg.norm(matrix, axis=0)
    solved = np.linalg.lstsq(matrix / sizes, force, rcond=None)[0] / sizes
    return {f"{link.name}.{name}": float(value) for name, value in zip(columns, solved, strict=True)}


_ROUNDING = 1e-9  # of the largest coefficient of an equation: what cancels but for rounding


def true_monomials(structure: Structure) -> set[tuple[str, str]]:
    """The monomials with a coefficient that is not 0, each beside its equation, as ("x1''", "x1**2*v2"), by the names of
    `monomial_equations`; applied forces are none of them. IdentificationError if a law is not a polynomial.
    """
    names = dict(zip(structure.mass_names, tags(structure.mass_names), strict=True))
    ends = {**names, BASE: "b"}
    variables = tuple(f"{kind}{tag}" for tag in (*names.values(), "b") for kind in "xv")
    monomials: set[tuple[str, str]] = set()
    for mass, tag in names.items():
        forces = [_monomial_force(link, mass, ends) for link in structure.links if mass in link.between]
        terms = polynomial(add(*forces), variables) if forces else {}
        if terms is None:
            raise IdentificationError(
                f"a law of a link of {mass} is not a polynomial in d and v, so no monomials represent it; use the library "
                '"links"'
            )
        sizes = {key: abs(value.value) for key, value in terms.items() if isinstance(value, Number)}
        least = _ROUNDING * max(sizes.values(), default=0.0)
        monomials |= {(f"x{tag}''", _name(variables, key)) for key, size in sizes.items() if size > least}
    return monomials


def _monomial_force(link: Link, mass: str, ends: dict[str, str]) -> Expression:
    """What a link adds to M x'' of a mass, with its numbers, in the states of its ends."""
    numbers: dict[str, Expression] = {name: Number(value) for name, value in link.values.items()}
    signed = zip((1.0, -1.0), link.between, strict=True)
    moving = [(Number(sign), ends[end]) for sign, end in signed if end != GROUND]
    elongations = {
        variable: add(*(multiply(sign, Symbol(f"{kind}{tag}")) for sign, tag in moving))
        for variable, kind in zip(VARIABLES, "xv", strict=True)
    }
    sign = Number(-1.0 if mass == link.between[0] else 1.0)
    return multiply(sign, substitute(substitute(link.law.expression, numbers), elongations))


def _name(variables: tuple[str, ...], exponents: tuple[int, ...]) -> str:
    powers = [(name, exponent) for name, exponent in zip(variables, exponents, strict=True) if exponent]
    return "*".join(name if exponent == 1 else f"{name}**{exponent}" for name, exponent in powers) or "1"


Library = Literal["links", "monomials"]


@final
class SindyMethod(StudyMethod, frozen=True):
    """Sparse regression for the terms themselves, from the displacements and the masses.

    The `library` "links" has one column for each of the `terms` on each link that there may be, which both masses share, as
    `discover` has; "monomials" has all monomials of all states up to `order`, and an equation for each mass. Monomials are not
    read as links, so that their rows have no error of forces. `threshold` is that of the regressor; None where it is chosen on
    rows held out. Raises IdentificationError for an unknown regressor, a threshold of one that has none, and terms that are no
    candidates.
    """

    looks_for_terms: ClassVar[bool] = True

    library: Library = "links"
    terms: str = DEFAULT
    order: Order = 3
    derivative: Derivative = "spline"
    regressor: str = "stlsq"
    threshold: Threshold | None = None
    kind: Literal["sindy"] = "sindy"

    def __post_init__(self) -> None:
        StudyMethod.__post_init__(self)
        _regressor(self.regressor, self.threshold)
        parse_terms(self.terms)

    @property
    def usual_name(self) -> str:
        return f"{self.kind}, {self.library}"

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses = masses_alone(subject, 'methods of the kind "sindy"')
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        if self.library == "links":
            return self._among_links(subject, clean, record, masses)
        return self._among_monomials(subject, record)

    def _among_links(
        self, subject: Subject, clean: Record, record: Record, masses: dict[str, float | str]
    ) -> MethodResult:
        started = perf_counter()
        full = candidates_for([record], masses, self.terms).full_structure
        equations = link_columns(differentiate(record, self.derivative), full)
        fit = _regressor(self.regressor, self.threshold).fit(equations)
        seconds = perf_counter() - started
        support = fit.support[:, 0]
        values = dict(zip(fit.names, np.where(support, fit.coefficients[:, 0], 0.0).tolist(), strict=True))
        links, terms = judged(full.with_values(values), subject, clean)
        chosen = {name: values[name] for name in np.array(fit.names)[support].tolist()}
        return _of_sindy(float(fit.residual[0]), seconds, links=links, coefficients=chosen, terms=terms)

    def _among_monomials(self, subject: Subject, record: Record) -> MethodResult:
        started = perf_counter()
        states = differentiate(record, self.derivative)
        equations = monomial_equations(states, self.order)
        targets = tuple(target for target in equations.targets if target.endswith("''"))
        fit = _fit(equations, Gram.of(equations), targets, _regressor(self.regressor, self.threshold))
        seconds = perf_counter() - started
        named = dict(zip(states.masses, tags(states.masses), strict=True))
        inputs = {(f"x{named[mass]}''", f"f{named[mass]}") for mass in states.driven}
        truth = true_monomials(subject.true_structure) | inputs
        chosen = {(target, name) for target in targets for name in fit.terms(target)}
        return _of_sindy(float(fit.residual.max()), seconds, terms=_counted_monomials(truth, chosen))


def _of_sindy(unexplained: float, seconds: float, **found: Any) -> MethodResult:
    """What was found, and what `PhysicsInformedSindy` would say of a fit that leaves such a share of the right-hand side."""
    verdict = Verdict.UNEXPLAINED_FORCES if unexplained > MAX_UNEXPLAINED else Verdict.CONVERGED
    reason = verdict.value if verdict.forbids else ""
    return MethodResult(status=verdict.status, seconds=seconds, reason=reason, **found)


def _counted_monomials(truth: set[tuple[str, str]], chosen: set[tuple[str, str]]) -> dict[str, int]:
    """The numbers of monomials as a row has them."""
    return {"right": len(truth & chosen), "missing": len(truth - chosen), "extra": len(chosen - truth)}


_KIND = 'methods of the kind "pysindy"'
_RIDGE = 1e-6  # its own, 0.05, would bend columns of norm 1


@final
class PySindyMethod(StudyMethod, frozen=True):
    """An equation for each mass in all monomials of all states up to `order`, by PySINDy.

    Velocities and accelerations are its smoothed differences over `window` samples, states are scaled to a standard deviation
    of 1 and columns and accelerations to a norm of 1, so that its `threshold` is a share of the right-hand side, which is how
    its users make a threshold mean the same in every equation. Threshold and window are by default those of PySINDy.
    """

    looks_for_terms: ClassVar[bool] = True

    order: Order = 3
    threshold: Threshold = 0.1
    window: Annotated[int, msgspec.Meta(ge=3)] = 11
    kind: Literal["pysindy"] = "pysindy"

    def evaluate(self, subject: Subject, clean: Record, snr_db: float, seed: int) -> MethodResult:
        masses_alone(subject, _KIND)
        record = subject.measured(clean).with_noise(snr_db, seed=seed)
        if record.inputs:
            raise IdentificationError(
                f'{_KIND} take no inputs, and the record has {", ".join(record.inputs)}; use the kind "sindy"'
            )
        if len(record) <= self.window:
            few = f"{len(record)} samples are too few"
            raise IdentificationError(f"{few} for smoothed differences over {self.window}")
        library = _pysindy()
        masses, started = subject.true_structure.mass_names, perf_counter()
        tagged = tags(masses)
        smoother = {"window_length": self.window, "polyorder": min(3, self.window - 1)}
        smooth = library.SmoothedFiniteDifference(smoother_kws=smoother)
        x = np.column_stack([record.channel(f"x:{mass}") for mass in masses])
        v = np.asarray(smooth(x, record.step))
        a = np.asarray(smooth(v, record.step))
        names = Monomials(tuple(f"{kind}{tag}" for tag in tagged for kind in "xv"), self.order).names
        states = np.stack([x, v], axis=2).reshape(len(x), -1)
        with warnings.catch_warnings():  # where nothing is left of an equation it warns and goes on
            warnings.simplefilter("ignore")
            scaled = states / np.std(states, axis=0)
            columns = np.asarray(library.PolynomialLibrary(degree=self.order).fit_transform(scaled))
            targets = a / np.linalg.norm(a, axis=0)
            optimizer = library.STLSQ(threshold=self.threshold, alpha=_RIDGE, normalize_columns=True)
            optimizer.fit(columns, targets)
        left = np.linalg.norm(targets - columns @ optimizer.coef_.T, axis=0)
        seconds = perf_counter() - started
        chosen = {
            (f"x{tag}''", names[column])
            for tag, equation in zip(tagged, optimizer.coef_, strict=True)
            for column in np.flatnonzero(equation)
        }
        truth = true_monomials(subject.true_structure)
        return _of_sindy(float(left.max()), seconds, terms=_counted_monomials(truth, chosen))


def _pysindy() -> Any:
    try:
        return import_module("pysindy")
    except ModuleNotFoundError as error:
        message = f"{_KIND} need the library pysindy; install it with pip install 'linkwise[peers]'"
        raise IdentificationError(message) from error
