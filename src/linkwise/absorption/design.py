"""Which coefficients and masses make sinks absorb best: `absorb` minimised over bounds, within budgets.

Sinks have thresholds of activation and chaotic transients, so that no quantity is a smooth function of a design: the search
samples the bounds by a Halton sequence and lets a population of the best evolve (differential evolution), again and again
while evaluations are left. Each generation is one ensemble of simulations.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple, Unpack, final

import numpy as np

from linkwise.absorption.absorb import AbsorptionKeywords, AbsorptionOptions, Comparison, compare
from linkwise.absorption.ensemble import AbsorptionQuantity, quantities_of, run_ensemble, variants
from linkwise.absorption.map import comparison_at, parameter_unit
from linkwise.absorption.resonance import RESONANCE, Resonance, curve_pool, sweep
from linkwise.absorption.result import Absorption, Rows, closure_verdict
from linkwise.absorption.search import LEAST, DesignAxis, Journal, Search, values_at, way_to
from linkwise.absorption.sinks import Places, placed, with_harvesters
from linkwise.arrays import Bools, Floats
from linkwise.display import JudgedView, align_columns, paragraph, remark_lines
from linkwise.errors import (
    LinkwiseError,
    SimulationError,
    StructureError,
    expect,
    options_given,
    require_known,
)
from linkwise.estimates.estimate import Estimate
from linkwise.estimates.uncertainty import Answer, KnownAnswer, Posterior
from linkwise.model.excitation import Excitation, Impulse, InputSignal, Sampled, TimeFunction
from linkwise.model.structure import Structure
from linkwise.progress import Progress, ProgressReport, part, silent
from linkwise.response.options import ResponseOptions
from linkwise.response.result import Response
from linkwise.verdict import UNGRADED, Basis, Verdict

ADDED_MASS = "added_mass"
"""The mass of all sinks in kg: a budget, and one side of the trade-off."""
OVER_LEVELS = ("worst", "mean")
_SHORT = {"energy": "remaining", "share": "sinks_share"}  # names of quantities that users type
_PER_PARAMETER = 100  # evaluations by default
_NEAR, _FEW = 0.02, 5  # of the spans: tolerances of what is built; designs from which a median is told
_ROWS = 10  # of a trade-off in a table
_AT_BOUND = 0.02  # of the span
_SIMULATED = 0.1  # of the time of a design that a response curve is followed for: its simulations


@final
@dataclass(frozen=True, kw_only=True)
class DesignOptions:
    """How `design` searches, and what counts as good.

    Parameters
    ----------
    evaluations : int, optional
        Designs that are simulated, each at every level and for every draw; by default 100 for each varied parameter.
    levels : sequence of float
        Factors of the excitation at which each design is judged; 1 by default.
    over_levels : {"worst", "mean"}
        Which value counts over the levels; the worst by default.
    quantile : float, optional
        The part of the draws from an identified structure that must be as good as stated, such as 0.9; by default the mean
        over the draws counts.
    draws : int
        Draws from an identified structure; 10 by default.
    limits : mapping of str to float, optional
        Largest values by quantity: added_mass in kg, stroke:LINK in m, or any other.
    maximise : bool
        Whether the largest value of the quantity is the best.
    places : mapping of str to sequence of str, optional
        Masses and points of hosts by link, on which the link may end, as ``{"nes1": ("m1", "m3")}``: each is searched with
        all evaluations, and several links with all combinations.
    harmonic : ResponseOptions, optional
        The harmonic excitation whose steady motion gives the quantity "resonance", as of `respond`. Where nothing else sets
        the structure in motion, its sweep does, from the lowest to the highest frequency in the duration that is simulated
        (by default 100 periods of the lowest).
    seed : int
        Seed of the search and of the draws; 0 by default.
    workers : int, optional
        Threads that simulate, and processes that follow the curves of a resonance; one for each processor by default.

    Raises
    ------
    LinkwiseError, SimulationError
        If a number is out of its range.

    Examples
    --------
    >>> from linkwise.absorption import DesignOptions
    >>> DesignOptions(levels=(0.5, 1.0, 2.0), limits={"added_mass": 0.02}).over_levels
    'worst'
    """

    evaluations: int | None = field(default=None, metadata={"typed": "N"})
    levels: Sequence[float] = (1.0,)
    over_levels: str = field(
        default="worst", metadata={"typed": "WAY", "choices": {name: name for name in OVER_LEVELS}}
    )
    quantile: float | None = field(default=None, metadata={"typed": "PART"})
    draws: int = field(default=10, metadata={"typed": "N"})
    limits: Mapping[str, float] | None = field(
        default=None, metadata={"typed": "QUANTITY=VALUE", "example": "added_mass=0.02"}
    )
    maximise: bool = False
    places: Places | None = None
    harmonic: ResponseOptions | None = None
    seed: int = field(default=0, metadata={"typed": "N"})
    workers: int | None = field(default=None, metadata={"typed": "N"})

    def __post_init__(self) -> None:
        for name, least in (("evaluations", LEAST), ("draws", 1), ("seed", 0)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, int) and value >= least):
                message = f"{name} must be a whole number from {least}, got {value!r}"
                raise LinkwiseError(message, arguments=(name,))
        if self.quantile is not None and not 0.0 < self.quantile < 1.0:
            message = f"quantile must be between 0 and 1, got {self.quantile!r}"
            raise LinkwiseError(message, arguments=("quantile",))
        if not len(self.levels) or not all(np.isfinite(level) and level > 0.0 for level in self.levels):
            raise SimulationError(f"levels must be positive factors of the excitation, got {self.levels!r}")
        require_known("way to count levels", self.over_levels, OVER_LEVELS)
        for name, own in (self.places or {}).items():
            if isinstance(own, str) or not own:
                raise StructureError(f"places must be a sequence of masses and points, got {own!r}", name)
        for name, value in (self.limits or {}).items():
            if not (isinstance(value, int | float) and 0.0 < value < np.inf):
                message = f"the limit of {name} must be a positive number, got {value!r}"
                raise LinkwiseError(message, arguments=("limits",))


@dataclass(frozen=True, eq=False, repr=False)
class Design(JudgedView):
    """The result of `design`; printed, the best design and the trade-off of mass against what was minimised.

    Attributes
    ----------
    structure : Structure
        The structure with the best values.
    axes : tuple of DesignAxis
        The P varied parameters.
    quantity : AbsorptionQuantity
        What was minimised, or maximised.
    options : DesignOptions
        How.
    best : dict of str to float
        The best values by parameter.
    objective : float
        The quantity there.
    given : float or None
        The same for the structure as it was given; None where it has no values within the bounds.
    points : (E, P) ndarray
        The designs that were evaluated, in their order.
    objectives : (E,) ndarray
        The quantity of each; NaN where it has none.
    added_mass : (E,) ndarray
        The mass of the sinks of each in kg.
    allowed : (E,) ndarray of bool
        Whether each keeps the limits.
    simulations : int
        Simulations made: evaluations times levels times draws.
    diverged : int
        How many of them diverged.
    closure : float
        The largest error of an energy balance, as a part of the energy supplied.
    absorption : Absorption
        What `absorb` says of the best structure under the excitation as given.
    response : Response or None
        What `respond` says of it under the harmonic excitation.
    basis : Basis
        The answer that the structure comes from.
    places : tuple of (dict, float)
        Where links were, by name, and the least of the quantity there, best first; NaN where no design keeps the limits.

    Examples
    --------
    >>> import linkwise as lw
    >>> few = lw.absorption.DesignOptions(evaluations=24)
    >>> over = {"m2.mass": (0.002, 0.05)}
    >>> found = lw.design(lw.bnes_chain(2), over, "rms", few, duration=0.5, release={"v:m1": 1.0})
    >>> found.trade_off[-1] == (found.best["m2.mass"], found.objective)
    True
    """

    structure: Structure
    axes: tuple[DesignAxis, ...]
    quantity: AbsorptionQuantity
    options: DesignOptions
    best: dict[str, float]
    objective: float
    given: float | None
    points: Floats
    objectives: Floats
    added_mass: Floats
    allowed: Bools
    simulations: int
    diverged: int
    closure: float
    absorption: Absorption
    response: Response | None = None
    basis: Basis = UNGRADED
    places: tuple[tuple[Mapping[str, str], float], ...] = ()

    @property
    def evaluations(self) -> int:
        """Designs that were evaluated, E."""
        return len(self.points)

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether the energy balance of every run closes, and what `absorb` says of the best."""
        return tuple(dict.fromkeys((*self.absorption.verdicts, closure_verdict(self.closure))))

    @property
    def trade_off(self) -> tuple[tuple[float, float], ...]:
        """Added mass in kg and quantity of the designs that no lighter one beats, lightest first."""
        sign = -1.0 if self.options.maximise else 1.0
        front: list[tuple[float, float]] = []
        usable = self.allowed & np.isfinite(self.objectives)
        for number in np.lexsort((sign * self.objectives, self.added_mass)):
            if usable[number] and (not front or sign * self.objectives[number] < sign * front[-1][1]):
                front.append((float(self.added_mass[number]), float(self.objectives[number])))
        return tuple(front)

    @property
    def nearby(self) -> tuple[int, float, float] | None:
        """How many designs were tried near the best, and the median and the worst of them; None of fewer than five.

        Near is within 2 % of the bounds, by every parameter.
        """
        off = [
            [way_to(axis, value) - way_to(axis, self.best[axis.name]) for value in values]
            for axis, values in zip(self.axes, self.points.T.tolist(), strict=True)
        ]
        near = (np.abs(off).max(axis=0) <= _NEAR) & np.isfinite(self.objectives)
        if (count := int(near.sum())) < _FEW:
            return None
        values = self.objectives[near]
        return count, float(np.median(values)), float(values.min() if self.options.maximise else values.max())

    @property
    def findings(self) -> tuple[str, ...]:
        """Sentences on what the search cannot show."""
        lines = []
        ways = {axis.name: way_to(axis, self.best[axis.name]) for axis in self.axes}
        if ends := ", ".join(name for name, way in ways.items() if not _AT_BOUND < way < 1.0 - _AT_BOUND):
            lines.append(f"The best lies at a bound of {ends}: widen it to see further.")
        if self.nearby is not None:
            count, *values = self.nearby
            median, worst = map(self.quantity.text, values)
            lines.append(
                f"{count} designs within {100.0 * _NEAR:g} % of the bounds around the best have {median} in the median and "
                f"{worst} at worst: what tolerances cost."
            )
        horizon = self.absorption.with_sinks.horizon
        if horizon is not None:
            lines.append(
                f"The motion of the best is chaotic past {horizon:.3g} s: from there on it is one run of many. Several levels "
                "or the draws of an identified structure find a design that does not depend on chance."
            )
        if self.diverged:
            diverged = f"{self.diverged} of {self.simulations} simulations diverged"
            lines.append(f"{diverged}, and count as the worst.")
        return tuple(lines)

    def to_dict(self) -> dict[str, Any]:
        """The result as plain data.

        Returns
        -------
        dict
            The content of design.json: "best" by parameter, "objective", "trade_off" and "evaluations"; SI units.
        """
        places = {"places": [{**where, "objective": value} for where, value in self.places]}
        near = self.nearby and dict(zip(("count", "median", "worst"), self.nearby, strict=True))
        return {
            "method": "design",
            **self._judgement(),
            "quantity": self.quantity.name,
            "unit": self.quantity.unit,
            "maximised": self.options.maximise,
            "best": self.best,
            **(places if self.places else {}),
            "objective": self.objective,
            "as_given": self.given,
            "trade_off": [{ADDED_MASS: mass, "objective": value} for mass, value in self.trade_off],
            "nearby": near,
            "evaluations": self.evaluations,
            "simulations": self.simulations,
            "diverged": self.diverged,
            "levels": list(self.options.levels),
            "seed": self.options.seed,
            "findings": list(self.findings),
        }

    def __str__(self) -> str:
        return "\n".join([
            *map(paragraph, design_headline(self)), "",
            *align_columns([(*row, "") for row in design_rows(self)]), "",
            *([*align_columns([(*row, "") for row in place_rows(self)]), ""] if self.places else []),
            *align_columns([(*row, "") for row in trade_off_rows(self)]),
            *map(remark_lines, self.findings),
        ])  # fmt: skip


def design_headline(design: Design) -> tuple[str, ...]:
    """The best value, and what was searched, in sentences."""
    given = "" if design.given is None else f"; as given {design.quantity.text(design.given)}"
    word = "largest" if design.options.maximise else "least"
    factors = ", ".join(f"{level:g}" for level in design.options.levels)
    levels = "" if factors == "1" else f", {design.options.over_levels} of the levels {factors}"
    count, title = len(design.places), design.quantity.title
    return (
        f"{title[:1].upper()}{title[1:]}: {design.quantity.text(design.objective)} at the best design{given}{levels}.",
        f"It is the {word} of {design.evaluations} designs ({design.simulations} simulations of "
        f"{design.absorption.time[-1]:g} s)" + (f" at each of {count} places." if count else "."),
    )


def design_rows(design: Design) -> Rows:
    """The best value of each parameter, and its bounds."""
    rows: Rows = [("parameter", "best", "from", "to", "unit")]
    for axis in design.axes:
        best = f"{design.best[axis.name]:.6g}"
        rows.append((axis.name, best, f"{axis.low:g}", f"{axis.high:g}", axis.unit))
    return rows


def place_rows(design: Design) -> Rows:
    """The best of each place at which links were, best first."""
    rows = [(*where.values(), design.quantity.text(value)) for where, value in design.places]
    return [(*(f"place of {link}" for link in design.places[0][0]), design.quantity.title), *rows]


def trade_off_rows(design: Design) -> Rows:
    """Added mass and quantity along the trade-off."""
    front = design.trade_off
    shown = [*front[: -1 : max(1, len(front) // _ROWS)], front[-1]]
    rows = [(f"{mass:.4g} kg", design.quantity.text(value)) for mass, value in shown]
    return [("mass of the sinks", design.quantity.title), *dict.fromkeys(rows)]


@dataclass(frozen=True, eq=False)
class _Problem:
    """What designs are judged by: what makes their comparisons at each level, for each of `drawn` sets of coefficients."""

    axes: tuple[DesignAxis, ...]
    levels: tuple[Callable[[Mapping[str, float]], Comparison], ...]
    drawn: tuple[Mapping[str, float], ...]
    quantity: AbsorptionQuantity
    options: DesignOptions
    mass_varies: bool
    resonance: Resonance | None
    pool: Executor | None = None

    def judge(self, points: Floats, progress: Progress) -> Floats:
        """(E, 5) of designs (E, P): the loss, least is best and inf the worst; by what part it exceeds limits; the mass in kg;
        how many runs diverged, and the largest error of an energy balance.
        """
        sign = -1.0 if self.options.maximise else 1.0
        limits = self.options.limits or {}
        named = [dict(zip([axis.name for axis in self.axes], row, strict=True)) for row in points.tolist()]
        losses, excesses, masses = [], [np.zeros((len(named), len(self.drawn)))], np.zeros(len(named))
        diverged, closure = np.zeros(len(named)), np.zeros(len(named))
        asked = {self.quantity.name, *limits} - {ADDED_MASS}
        simulated = _SIMULATED if RESONANCE in asked else 1.0
        for number, (factor, at) in enumerate(zip(self.options.levels, self.levels, strict=True)):
            comparisons = [at({**draw, **values}) for values in named for draw in self.drawn]
            masses = np.array([_added_mass(own) for own in comparisons]).reshape(len(named), -1).max(axis=1)
            share = part(progress, number / len(self.levels), (number + 1) / len(self.levels))
            runs = part(share, 0.0, simulated)
            ensemble = run_ensemble(comparisons, workers=self.options.workers, progress=runs)
            column = {name: ensemble.column(name) for name in asked - {RESONANCE}}
            if self.resonance is not None and RESONANCE in asked:
                structures = [comparison.structure for comparison in comparisons]
                followed = part(share, simulated, 1.0)
                column[RESONANCE] = self.resonance.values(structures, factor, followed, self.pool)
            diverged += np.sum(~ensemble.completed.reshape(len(named), -1), axis=1)
            closures = np.nan_to_num(ensemble.column("closure")).reshape(len(named), -1)
            closure = np.maximum(closure, closures.max(axis=1))
            loss = sign * column[self.quantity.name]
            losses.append(np.where(np.isnan(loss), np.inf, loss).reshape(len(named), -1))
            for name, most in limits.items():
                if name != ADDED_MASS:
                    excess = np.maximum(column[name] / most - 1.0, 0.0)
                    excesses.append(np.where(np.isnan(excess), np.inf, excess).reshape(len(named), -1))
        worst = np.max(excesses, axis=(0, 2))
        if ADDED_MASS in limits:
            worst = np.maximum(worst, masses / limits[ADDED_MASS] - 1.0)
        return np.column_stack([self._counted_loss(np.array(losses)), worst, masses, diverged, closure])

    def _counted_loss(self, losses: Floats) -> Floats:
        """(E,) the loss that counts, of those (levels, E, draws)."""
        if self.options.quantile is None:
            over_draws = losses.mean(axis=2)
        else:
            over_draws = np.quantile(losses, self.options.quantile, axis=2, method="higher")
        worst = self.options.over_levels == "worst"
        return np.asarray(over_draws.max(axis=0) if worst else over_draws.mean(axis=0))


def _added_mass(comparison: Comparison) -> float:
    carried = {sink.mass for sink in comparison.sinks}
    masses = zip(comparison.structure.mass_names, comparison.structure.mass_values.tolist(), strict=True)
    return float(sum(value for name, value in masses if name in carried))


def design(
    structure: Answer,
    over: Mapping[str, tuple[float, float]],
    minimise: str = "remaining",
    options: DesignOptions | None = None,
    *,
    journal: str | Path | None = None,
    executor: Executor | None = None,
    progress: Progress = silent,
    **keywords: Unpack[AbsorptionKeywords],
) -> Design:
    """Find the coefficients and masses at which sinks absorb best.

    Parameters
    ----------
    structure : Structure, Estimate, Posterior, str or Path
        The structure with its sinks, or its file; of an identified one, or its folder, draws are judged.
    over : mapping of str to (float, float)
        Bounds by coefficient ("nes1.alpha") or mass ("m2.mass"), in SI units.
    minimise : str
        The quantity: "peak" or "rms" in m of the primary masses, "remaining" (the part of the energy that is left at the
        end), "sinks_share", "settled", "power:LINK", "stroke:LINK" or another one of `absorption_map`; or "resonance", the
        largest steady amplitude of the primary masses under the harmonic excitation of the options.
    options : DesignOptions, optional
        How the search is made: evaluations, levels, limits, seed, whether to maximise.
    journal : str or Path, optional
        A file in which designs that were judged are kept until the search ends: the same call goes on where one was
        interrupted.
    executor : concurrent.futures.Executor, optional
        What follows the response curves of a resonance, in place of processes of this machine: an executor of any library
        with this interface, as of `run_study`. It is not shut down.
    progress : Progress
        Called with a `ProgressReport` as simulations end.
    **keywords
        What is simulated, as in `absorb`: `duration`, `rate`, `sinks`, `release`, `impulses`, `forces`, `base` and others.

    Returns
    -------
    Design
        The best design, its structure, the trade-off of mass, and all designs that were evaluated.

    Raises
    ------
    StructureError
        If a parameter does not exist or its bounds are not in order, and as `absorb`.
    LinkwiseError
        If no design has a value of the quantity within the limits.
    SimulationError
        If there is no such quantity, and as `absorb`.

    Examples
    --------
    >>> import linkwise as lw
    >>> from linkwise.absorption import DesignOptions
    >>> few = DesignOptions(evaluations=24)
    >>> over = {"nes1.alpha": (-300.0, -20.0)}
    >>> found = lw.design(lw.bnes_chain(2), over, "remaining", few, duration=1.0, release={"v:m1": 1.0})
    >>> found.evaluations, found.objective < found.given
    (24, True)
    """
    expect("design(structure, over): structure", structure, Structure, Estimate, Posterior, str, Path)
    expect("design(structure, over): over", over, Mapping)
    options = options or DesignOptions()
    given = KnownAnswer.of(structure)
    subject, drawn = given.structure, _drawn_beside(given.posterior, options, over)
    simulated = options_given(AbsorptionOptions.of, None, keywords)
    asked = _Question(drawn, over, minimise, options, simulated)
    at_places = list(placed(subject, options.places or {}))
    designs: list[Design | None] = []
    with curve_pool(None if options.harmonic is None else options.workers, executor) as pool:
        for number, (_, moved) in enumerate(at_places):
            journal_file = None if journal is None else Path(f"{journal}{number or ''}")
            share = part(progress, number / len(at_places), (number + 1) / len(at_places))
            designs.append(_best_design(moved, asked, journal_file, pool, share))
    sign = -1.0 if options.maximise else 1.0
    best = min((own for own in designs if own), key=lambda own: sign * own.objective, default=None)
    if best is None:
        kept = "keeps the limits and has" if options.limits else "has"
        count = len(at_places) * (options.evaluations or _PER_PARAMETER * len(over))
        raise LinkwiseError(
            f"none of {count} designs {kept} a value of {_SHORT.get(minimise, minimise)}: widen the bounds"
            f"{', raise the limits' if options.limits else ''} or simulate for longer"
        )
    pairs = list(zip(designs, at_places, strict=True))
    as_given = (candidate.given for candidate, (_, moved) in pairs if candidate and moved == subject)
    places = [(where, own.objective if own else np.nan) for own, (where, _) in pairs if where]
    places.sort(key=lambda place: np.nan_to_num(sign * place[1], nan=np.inf))
    return replace(best, given=next(as_given, None), basis=given.basis, places=tuple(places))


class _Question(NamedTuple):
    """What is asked of a structure: the coefficients that draws have, what is varied and minimised, how, and what runs."""

    drawn: tuple[Mapping[str, float], ...]
    over: Mapping[str, tuple[float, float]]
    minimise: str
    options: DesignOptions
    simulated: AbsorptionOptions


def _best_design(
    subject: Structure, asked: _Question, journal: Path | None, pool: Executor | None, progress: Progress
) -> Design | None:
    """The best design of one structure; None where none keeps the limits and has a value."""
    drawn, over, _, options, _ = asked
    problem, comparison = _design_problem(subject, asked)
    budget = options.evaluations or _PER_PARAMETER * len(problem.axes)
    regardless = asked._replace(options=replace(options, evaluations=None, workers=None))
    before = Journal(journal, (subject, *regardless))
    progress(ProgressReport(0.0, f"{budget} designs"))
    start = _way_as_given(subject, problem.axes)
    within = part(progress, 0.0, 0.95)
    search = Search(replace(problem, pool=pool), budget, options.seed, before, within)
    if start is not None:
        search.evaluate(start[None])
    search.run()
    if (best := search.best()) is None:
        return None
    sign = -1.0 if options.maximise else 1.0
    values = dict(zip(over, search.values(search.ways[best : best + 1])[0].tolist(), strict=True))
    objectives = np.where(np.isinf(search.loss), np.nan, sign * search.loss)
    at, resonance = variants(comparison.structure, comparison, list(over)), problem.resonance
    absorption = compare(at(values), part(progress, 0.95, 1.0))
    return Design(
        structure=subject.with_values(values),
        axes=problem.axes,
        quantity=problem.quantity,
        options=options,
        best=values,
        objective=float(objectives[best]),
        given=None if start is None or np.isnan(objectives[0]) else float(objectives[0]),
        points=search.values(search.ways),
        objectives=objectives,
        added_mass=search.mass,
        allowed=search.excess <= 0.0,
        simulations=len(search.ways) * len(options.levels) * len(drawn),
        diverged=int(search.diverged.sum()),
        closure=float(search.closure.max()),
        absorption=absorption,
        response=None if resonance is None else resonance.response(absorption.with_sinks.structure),
    )


def _drawn_beside(
    posterior: Posterior | None, options: DesignOptions, over: Mapping[str, Any]
) -> tuple[Mapping[str, float], ...]:
    """The coefficients beside the varied ones that draws have; a single empty set where there are none."""
    if posterior is None or set(posterior.names) <= set(over):
        return ({},)
    rows = posterior.draws(options.draws, options.seed).tolist()
    draws = [dict(zip(map(str, posterior.names), row, strict=True)) for row in rows]
    return tuple({name: draw[name] for name in draw if name not in over} for draw in draws)


def _design_problem(structure: Structure, asked: _Question) -> tuple[_Problem, Comparison]:
    """The problem, and the comparison in the middle of the bounds under the excitation as given."""
    drawn, over, minimise, options, simulated = asked
    equipped = with_harvesters(structure, simulated.harvesters or {})
    if options.harmonic is not None:
        options.harmonic.drive.check(equipped)
        if simulated.excitation.is_empty:
            swept, duration = sweep(options.harmonic, simulated.duration)
            simulated = replace(simulated, excitation=swept, duration=duration)
    axes = tuple(_design_axis(equipped, name, bounds) for name, bounds in over.items())
    if not axes:
        raise StructureError("nothing is varied: name at least one coefficient or mass with its bounds")
    middle = {axis.name: float(values_at(axis, np.array(0.5))) for axis in axes}
    comparison = comparison_at(structure, middle, simulated)
    resonance = None if options.harmonic is None else Resonance.of(comparison, options.harmonic)
    quantities = {quantity.name: quantity for quantity in quantities_of(comparison)}
    if resonance is not None:
        quantities[RESONANCE] = resonance.quantity
    elif RESONANCE in (minimise, *(options.limits or ())):
        raise SimulationError(
            "the resonance is that of steady motion: give a harmonic excitation with its lowest and highest frequency",
            arguments=("harmonic",),
        )
    known = list(quantities)
    powers = [name for name in known if name.startswith("power:")]
    name = powers[0] if minimise == "power" and len(powers) == 1 else _SHORT.get(minimise, minimise)
    require_known("quantity", name, known, SimulationError)
    for limit in options.limits or ():
        require_known("quantity", limit, [ADDED_MASS, *known], SimulationError)
    varied = list(dict.fromkeys([*over, *drawn[0]]))
    fixed = replace(comparison.options, duration=float(comparison.times[-1]))
    levels = []
    for factor in options.levels:
        scaled = replace(fixed, excitation=_scaled(fixed.excitation, float(factor)))
        at_level = comparison if factor == 1.0 else comparison_at(structure, middle, scaled)
        baseline = replace(at_level.baseline, times=comparison.times)
        levels.append(variants(equipped, replace(at_level, baseline=baseline), varied))
    # errors of a bound come before the work
    ends = ({axis.name: getattr(axis, end) for axis in axes} for end in ("low", "high"))
    lightest, heaviest = (_added_mass(levels[0](values)) for values in ends)
    varies = lightest != heaviest
    problem = _Problem(axes, tuple(levels), drawn, quantities[name], options, varies, resonance)
    return problem, comparison


def _design_axis(structure: Structure, name: str, bounds: tuple[float, float]) -> DesignAxis:
    if ":" in name:
        message = "a design varies coefficients and masses; a release belongs to the excitation"
        raise StructureError(message, name)
    unit = parameter_unit(structure, name)
    low, high = (float(bound) for bound in bounds)
    if not -np.inf < low < high < np.inf:
        message = f"the bounds must be two finite numbers, the lower one first, got {low:g} and {high:g}"
        raise StructureError(message, name)
    return DesignAxis(name, unit, low, high)


def _way_as_given(structure: Structure, axes: Sequence[DesignAxis]) -> Floats | None:
    """The structure as it is in the unit cube of parameters; None if it is not in there."""
    values = [structure.coefficient(axis.name).value for axis in axes]
    ways = [-1.0 if value is None else way_to(axis, value) for value, axis in zip(values, axes, strict=True)]
    return np.array(ways) if all(0.0 <= way <= 1.0 for way in ways) else None


def _scaled(excitation: Excitation, factor: float) -> Excitation:
    """The excitation times a factor."""

    def scaled(signal: InputSignal) -> InputSignal:
        if isinstance(signal, Sampled):
            return replace(signal, values=factor * signal.values)
        return TimeFunction(f"{factor!r}*({signal.text})")

    return Excitation(
        {name: factor * value for name, value in excitation.release.items()},
        tuple(Impulse(own.mass, factor * own.momentum, own.time) for own in excitation.impulses),
        {mass: scaled(force) for mass, force in excitation.forces.items()},
        None if excitation.base is None else scaled(excitation.base),
    )
