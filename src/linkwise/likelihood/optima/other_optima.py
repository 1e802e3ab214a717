"""Where the likelihood has other optima than that of a fit: chaotic motion, low signals, faint links and faint modes.

The likelihood of chaotic motion or of noisy records has many local optima. A search of many steps indicates them, and a second
search, or the cost a few standard errors away, finds one; a search of few steps is trusted.

At a low signal exact laws are held as closely as leaves the likelihood one optimum. The closer the motion must follow the
laws, the longer each sample says something of the parameters. Where neighbouring motions part, noise then leaves the
likelihood with many narrow optima. A search that tightens the links between segments quickly ends in one that is not the
highest, and the curvature there says nothing of the distance to the others. With looser links the motion forgets before that
happens, and the likelihood has one optimum. From there the links are tightened slowly, with -2 log of the marginal likelihood
at each relaxation: it falls towards exact laws in the right valley and rises in a wrong one. Where the tightest links leave no
quadratic likelihood, the tightest that do are kept, if the likelihood also falls by enough along the profile of each
parameter; their covariance takes the loosened links for noise, and is on the safe side.

The coefficients of links whose elongation hardly stands above the noise may not be determined far from the estimates. The
frequency of a faint vibration is like the peak of a periodogram: its phase, followed through the whole record, makes the peak
narrow, and other peaks are as high. What the curvature promises at a distance, the likelihood then does not keep: it cannot
rise by more than twice the energy of the elongation over that of the noise, and by no more than that energy to where the link
is rigid. Only vibration of its own counts: what the links beside it force upon a link follows them, whatever its stiffness,
and may stand far above the noise.

Of frequencies and damping of modes that a record hardly shows the curvature of the likelihood says too much: that of a
frequency is a peak of a periodogram, quadratic only within a part of its width. A mode that noise hides has other peaks within
what is known of it beforehand, about as likely as that which is found, and takes its damping from the width of the one that it
ends at.

References
----------
V. F. Pisarenko and D. Sornette, "Statistical methods of parameter estimation for deterministically chaotic time series",
Phys. Rev. E 69, 036122 (2004).
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from linkwise.arrays import Bools, Floats, Indices
from linkwise.errors import IdentificationError
from linkwise.expression import symbols
from linkwise.likelihood.fit import CostShape, LikelihoodFit, inflation_beside_others
from linkwise.likelihood.marginal import is_long
from linkwise.likelihood.noise import evidence
from linkwise.likelihood.search import Optimum
from linkwise.likelihood.shooting.minimise import Annealer, AnnealingFit, AnnealingSchedule, AnnealingStatus
from linkwise.likelihood.shooting.normal_equations import linearise
from linkwise.likelihood.shooting.segments import A, F, Iterate, S, V, X
from linkwise.likelihood.shooting.system import MANY
from linkwise.model.coefficient import Name
from linkwise.model.structure import Structure

_STRAIGHT = 10  # steps of annealing up to which there is no sign of another optimum
_DOUBLED = 5.0  # more of them for twice the masses, of which the slowest to converge decides
_DIRECTIONS = 2  # in which the cost is evaluated
_EXHAUSTED = AnnealingSchedule.max_steps  # steps after which a search was taken up again
_DISTANCE = 2.0  # standard errors
# of annealing in each direction; a tenth of the cost there is 2.5 % of the rise that is expected at two standard errors
_QUICK = AnnealingSchedule(tolerance=0.1, max_steps=60)
_LOOSENED = 1e-2  # relaxation from which laws are tightened once parameters were moved
_IRREGULAR = 4.0  # factor on the rise of the cost beyond which it is not quadratic
_IRREGULAR_UNCONVERGED = 100.0  # the same where annealing did not converge: the rise is then an upper bound
_WEAKEST = 2  # directions that the record determines least
_FAR = 3.0  # standard errors that the parameters are moved in these
_TOO_LITTLE = 0.5  # of the rise expected there: the valley bends, or another one is near
_PARTED = 60.0  # exponent: errors of driven chains of two masses hold at 10 to 50, in 1.5 to 3 s, and not at 70 to 90, in 6 s
_NEARLY_AS_EXPECTED = 0.8  # of the rise along the profiles of such motion
_SEED = 20261122


def went_straight(fit: LikelihoodFit) -> bool:
    """Whether there is no sign of another optimum: few steps, or a model error or a random force, which smooths the
    likelihood.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    bool
        Whether there is none.
    """
    masses = len(fit.segments.system.incidence)
    more = _DOUBLED * np.log2(masses / MANY) if masses > MANY else 0.0
    return len(fit.path) <= _STRAIGHT + more or fit.model_error > 0.0 or bool(fit.random_forces)


def lower_of_two(fit: LikelihoodFit, search: Callable[[Floats], LikelihoodFit]) -> LikelihoodFit:
    """Repeat a fit that converged only after many steps, and keep the better one.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    search : callable
        Fits again from given parameters (p,).

    Returns
    -------
    LikelihoodFit
        The fit with the lower chi-square.
    """
    if not fit.converged or went_straight(fit):
        return fit
    again = search(fit.values)
    if again.interrupted:
        return again
    better = again.converged and again.chi_square < fit.chi_square
    if not better or again.model_error > 0.0:
        return fit
    return replace(again, path=max(fit.path, again.path, key=len))


def is_regular(fit: LikelihoodFit, faint: Sequence[str] = ()) -> bool:
    """Whether the cost around the optimum rises as the covariance predicts; tested only after many steps.

    The parameters are moved by two standard errors in random directions, and by three in the directions that the record
    determines least, and held, and the orbit is fitted again. A narrow valley that bends leaves the latter only. A search that
    converged only after it had run out of steps crossed a likelihood too uneven for its curvature to say much.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that stay where they are, as their intervals do not rest on the covariance.

    Returns
    -------
    bool
        Whether it does.
    """
    if went_straight(fit):
        return True
    if len(fit.path) > _EXHAUSTED:
        return False
    if fit.shape is CostShape.REGULAR:
        return True
    known = fit.shape is CostShape.QUADRATIC
    return (known or is_quadratic(fit, faint)) and rises_in_weak_directions(fit, faint)


def is_quadratic(
    fit: LikelihoodFit,
    faint: Sequence[str] = (),
    *,
    factor: float = _IRREGULAR,
    sides: Sequence[float] = (1.0,),
) -> bool:
    """Whether the cost rises as the covariance predicts where the parameters are moved by two standard errors and held.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that are not moved.
    factor : float, optional
        By which the rise may differ from the prediction.
    sides : sequence of float, optional
        Signs of the two random directions that are taken.

    Returns
    -------
    bool
        Whether it does.
    """

    def random(root: Floats) -> Floats:
        directions = np.random.default_rng(_SEED).normal(size=(_DIRECTIONS, len(root)))
        directions *= _DISTANCE / np.linalg.norm(directions, axis=1, keepdims=True)
        return np.asarray(directions @ root.T)

    for moved in _moves(fit, faint, random, sides):
        rise, converged = rise_of(fit, *moved, _DISTANCE)
        if not (1.0 / factor < rise < factor if converged else rise < _IRREGULAR_UNCONVERGED):
            return False
    return True


def rises_in_weak_directions(fit: LikelihoodFit, faint: Sequence[str] = ()) -> bool:
    """Whether the cost rises by enough where the parameters are moved in the directions that the record determines least.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    faint : sequence of str, optional
        Parameters that stay where they are.

    Returns
    -------
    bool
        Whether it does.
    """
    weak = _moves(fit, faint, lambda root: _FAR * root.T[-_WEAKEST:], _BOTH)
    return all(rises_by(_TOO_LITTLE, fit, *moved, _FAR) for moved in weak)


def _moves(
    fit: LikelihoodFit, faint: Sequence[str], steps: Callable[[Floats], Floats], sides: Sequence[float]
) -> Iterator[tuple[Floats, Bools]]:
    """All parameters after `steps` (k, f) of the f that are free and not `faint` to some sides, from the principal axes of
    their covariance, and that all are held; nothing where there is no covariance.
    """
    free = np.flatnonzero(fit.free & ~np.isin(fit.segments.system.parameters.names, list(faint)))
    root = _root_of_covariance(fit, free)
    for step in () if root is None else steps(root):
        for side in sides:
            theta = fit.optimum.point.theta.copy()
            theta[free] += side * step
            yield theta, np.ones(len(theta), dtype=bool)


def profiles_rise(fit: LikelihoodFit, least: float = _TOO_LITTLE) -> bool:
    """Whether -2 log likelihood rises by enough along the profile of each parameter.

    A valley that bends, or another one that crosses it, may be seen in profiles alone, which follow it.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    least : float, optional
        Of the rise that is expected.

    Returns
    -------
    bool
        Whether it does.
    """
    variances, free = fit.covariance.diagonal(), np.flatnonzero(fit.free)
    determined = np.isfinite(variances[free]).all() and (variances[free] > 0.0).all()
    return bool(determined) and all(_profile_rises(fit, column, _FAR, least) for column in free.tolist())


def _profile_rises(fit: LikelihoodFit, column: int, distance: float, least: float) -> bool:
    """Whether -2 log likelihood rises by a part of what is expected where a parameter is moved within its bounds and held."""
    bounds = fit.segments.system.parameters
    for side in _BOTH:
        theta, is_fixed = along_profile(fit, column, side * distance)
        if bounds.lower[column] < theta[column] < bounds.upper[column]:
            try:
                if not rises_by(least, fit, theta, is_fixed, distance):
                    return False
            except IdentificationError:  # the motion runs to infinity
                continue
    return True


def rises_by(least: float, fit: LikelihoodFit, theta: Floats, is_fixed: Bools, distance: float) -> bool:
    """Whether -2 log likelihood is higher by enough where some parameters are moved and held.

    Parameters
    ----------
    least : float
        Of the rise that is expected.
    fit : LikelihoodFit
        The fit.
    theta : array of shape (p,)
        Parameters after the move.
    is_fixed : array of bool, shape (p,)
        Those that keep these values; the others are fitted again.
    distance : float
        Of the move in standard errors.

    Returns
    -------
    bool
        Whether it is.
    """
    return rise_of(fit, theta, is_fixed, distance, enough=least)[0] > least


def along_profile(fit: LikelihoodFit, column: int, distance: float) -> tuple[Floats, Bools]:
    """All parameters, one moved by a `distance` in standard errors and the others as they follow it, and which is held."""
    covariance = _covariance(fit)
    step = distance * covariance[column] / np.sqrt(covariance[column, column])
    return fit.optimum.point.theta + step, np.arange(len(step)) == column


def _covariance(fit: LikelihoodFit) -> Floats:
    """(p, p) covariance of the parameters as the cost has it, which takes the noise for white."""
    of_white = fit.optimum.of_white
    return fit.covariance if of_white is None else of_white


def _root_of_covariance(fit: LikelihoodFit, free: Indices) -> Floats | None:
    """(f, f) principal axes of the correlations of the free parameters, as the cost has them, each as long as its standard
    deviation, the longest last; None where there is no covariance.
    """
    covariance = _covariance(fit)[np.ix_(free, free)]
    if not len(free) or not np.isfinite(covariance).all():
        return None
    scale = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    variances, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    vectors = vectors * np.where(vectors[-1] < 0.0, -1.0, 1.0)  # signs differ from one machine to another
    return np.asarray(scale[:, None] * (vectors * np.sqrt(np.maximum(variances, 0.0))))


def rise_of(
    fit: LikelihoodFit, theta: Floats, is_fixed: Bools, distance: float, *, enough: float = np.inf
) -> tuple[float, bool]:
    """The rise of -2 log likelihood over that expected at a `distance` in standard errors, and whether the orbit was found.

    An upper bound of it where it was not; a lower one where it is surely more than `enough`.
    """
    optimum = fit.optimum
    lowest, expected = fit.misfit.cost(optimum.q), (distance * optimum.noise) ** 2
    schedule = replace(_QUICK, sufficient_cost=float(lowest + enough * expected))
    moved = refitted(optimum, replace(optimum.point, theta=theta), is_fixed, schedule)
    q = moved.q if moved.status is AnnealingStatus.COSTLY else optimum.q
    rise = float((moved.misfit.cost(q) - lowest) / expected)
    return rise, moved.status is AnnealingStatus.CONVERGED


def refitted(
    optimum: Optimum, point: Iterate, is_fixed: Bools, schedule: AnnealingSchedule | None = None
) -> AnnealingFit:
    """The orbit fitted again, those parameters unchanged that `is_fixed` (p,) marks.

    It is found from loosened links, but in a long record: somewhere in it these would lead states to another optimum than
    that of the fit, which costs more than the parameters.
    """
    system, q = optimum.segments.system, optimum.q
    lower = np.where(is_fixed, point.theta, system.parameters.lower)
    upper = np.where(is_fixed, point.theta, system.parameters.upper)
    constrained = replace(system, parameters=replace(system.parameters, lower=lower, upper=upper))
    misfit = replace(optimum.misfit, segments=replace(optimum.segments, system=constrained))
    misfit.orbit.release()
    schedule = schedule or AnnealingSchedule()
    return Annealer()(
        misfit.at(replace(point, theta=np.clip(point.theta, lower, upper))),
        replace(schedule, initial_q=q if is_long(optimum.segments) else max(q, _LOOSENED), final_q=q),
    )


_WIDTH = 0.2  # of half the bandwidth of a mode: the largest standard error of its frequency for a quadratic likelihood


def with_faint_modes(fit: LikelihoodFit, identified: Structure) -> tuple[Floats, tuple[Name, ...]]:
    """The covariance of a fit in which faint modes keep the standard deviations known beforehand.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    identified : Structure
        The structure with its values.

    Returns
    -------
    covariance : array of shape (p, p)
        The covariance; correlations stay.
    names : tuple of str
        The frequencies and damping of these modes.
    """
    segments, covariance = fit.segments, fit.covariance
    if segments.prior is None or not identified.hosts:
        return covariance, ()
    errors, known = np.sqrt(np.maximum(covariance.diagonal(), 0.0)), segments.prior.deviation
    # with all others held: a link that shifts a mode hides none
    alone = errors / np.sqrt(np.maximum(inflation_beside_others(covariance), 1.0))
    places = {name: number for number, name in enumerate(segments.system.parameters.names)}
    duration = float(np.sum(segments.step)) * segments.steps
    factor, names = np.ones(len(fit.values)), []
    for place, frequency in places.items():
        mode = place.owner
        if mode not in identified.modes or place.key != "frequency" or not np.isfinite(known[frequency]):
            continue
        values = identified.link(mode).values
        if not alone[frequency] > _WIDTH * max(values["damping"] * values["frequency"], 0.5 / duration):
            continue
        for name in (place, Name(mode, "damping")):
            number = places.get(name)
            if number is not None and 0.0 < errors[number] < known[number] < np.inf:
                factor[number] = known[number] / errors[number]
                names.append(name)
    return covariance * np.outer(factor, factor), tuple(names)


# power of a channel over that of its noise, 15 dB, below which few steps are no sign of one optimum
_LOW_SIGNAL = 10.0**1.5
_LADDER = (3e-2, 1e-2, 3e-3, 1e-3, 3e-4, 1e-4, AnnealingSchedule.final_q)
_SINGLE = 1e-2  # relaxation down to which noise as strong as the motion leaves one optimum
_RELAXED_STEPS = 40  # at each relaxation; a search that takes more has left the valley
# of -2 log of the marginal likelihood: more than rounding and the error of Laplace's approximation
_WORSE = 2.0
_AGREES = 1.0  # of the cost: two searches that ended in the same optimum
_FACTOR = 2.0  # by which the cost may rise more or less than the covariance predicts
_BOTH = (1.0, -1.0)
_ON_THE_WAY = 3.0  # times the noise, in power: residuals of a search that gaps alone may hold up


Refit = Callable[[Floats, Floats, float], LikelihoodFit]
"""`likelihood_fit` of exact laws from values and states, down to a relaxation."""


def tightest_smooth_fit(fit: LikelihoodFit, refit: Refit) -> LikelihoodFit:
    """`fit`, or where its likelihood has other optima the closest fit to exact laws whose likelihood is quadratic.

    Looked at are fits with white noise and without a model error, at a low signal, of many steps, or not converged.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit of exact laws.
    refit : callable
        Fits again.

    Returns
    -------
    LikelihoodFit
        The fit; the given one where no other is better.
    """
    if not _may_be_wrong(fit):
        return fit
    converged, low = fit.converged, _is_low(fit)
    least = _NEARLY_AS_EXPECTED if _stays_chaotic(fit) else _TOO_LITTLE
    bends = least > _TOO_LITTLE and not profiles_rise(fit, least)
    if converged and not low and not bends and _is_smooth(fit):
        return replace(fit, shape=CostShape.QUADRATIC)
    relaxed = list(_relaxed_fits(fit))
    if not relaxed or relaxed[-1][0].status is AnnealingStatus.INTERRUPTED:
        return fit
    tightest = relaxed[-1][0]
    agrees = (
        tightest.q <= fit.optimum.q
        and fit.misfit.cost(fit.optimum.q) < tightest.misfit.cost(tightest.q) + _AGREES
    )
    if agrees and converged and low and not bends and _is_smooth(fit) and rises_in_weak_directions(fit):
        return replace(fit, shape=CostShape.REGULAR)
    likeliest = min(marginal for _, marginal in relaxed)
    for candidate, marginal in reversed(relaxed):
        if marginal > likeliest + _WORSE and candidate.q < _SINGLE:
            continue
        try:
            again = refit(candidate.point.theta, candidate.point.nodes, candidate.q)
        except IdentificationError:  # the motion runs away
            continue
        if again.interrupted:
            return fit
        is_good = again.converged and not again.chi_square_off
        if is_good and _is_smooth(again) and profiles_rise(again, least):
            return replace(again, shape=CostShape.QUADRATIC)
    return fit


def is_loosened(fit: LikelihoodFit) -> bool:
    """Whether laws that are taken as exact hold between the segments of a fit only to within its relaxation.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.

    Returns
    -------
    bool
        Whether they do.
    """
    exact = fit.converged and fit.model_error == 0.0 and not (fit.random_forces or fit.noise_from_misfit)
    return exact and fit.optimum.q > AnnealingSchedule.final_q


def _relaxed_fits(fit: LikelihoodFit) -> Iterator[tuple[AnnealingFit, float]]:
    """Fits at ever smaller relaxations, each from the one before, as long as they converge, and -2 log marginal likelihood."""
    optimum, point = fit.optimum, fit.optimum.point
    for q in _LADDER:
        relaxed = optimum.searched(q, _RELAXED_STEPS, point)
        if relaxed.status not in (AnnealingStatus.CONVERGED, AnnealingStatus.INTERRUPTED):
            return
        yield relaxed, evidence(relaxed)[1]
        if relaxed.status is AnnealingStatus.INTERRUPTED:
            return
        point = relaxed.point


def _may_be_wrong(fit: LikelihoodFit) -> bool:
    """Whether the search for exact laws may have ended in an optimum that is not the highest."""
    if fit.interrupted or fit.model_error > 0.0:
        return False
    if fit.random_forces or fit.optimum.coloured is not None:
        return False
    if not fit.converged:
        return fit.misfit.data < _ON_THE_WAY * fit.samples
    if fit.optimum.q > AnnealingSchedule.final_q:
        return False
    return _is_low(fit) or not went_straight(fit) or _stays_chaotic(fit)


@lru_cache(maxsize=1)
def _stays_chaotic(fit: LikelihoodFit) -> bool:
    """Whether inputs keep up a motion in which neighbouring ones part, so that valleys of the likelihood may bend.

    The motion after a hit or a release parts at most as long as it is large.
    """
    optimum, inputs = fit.optimum, fit.segments.inputs
    acting = [values for values in (inputs.force, inputs.base, inputs.frame) if values is not None]
    if not acting or len(fit.segments.system.incidence) >= MANY:
        return False
    linear = linearise(optimum.misfit)
    apart = np.random.default_rng(_SEED).normal(size=linear.joined.shape[1])
    parted = most = 0.0
    for end, joined in zip(linear.state_ends, linear.joined, strict=True):
        apart = end @ (apart / np.linalg.norm(apart))
        parted = max(0.0, parted + float(np.log(np.linalg.norm(apart)))) if joined.any() else 0.0
        most = max(most, parted)
    return most > _PARTED


def _is_smooth(fit: LikelihoodFit) -> bool:
    return is_quadratic(fit, factor=_FACTOR, sides=_BOTH)


def _is_low(fit: LikelihoodFit) -> bool:
    """Whether a channel is hardly above its noise."""
    segments, sigma = fit.segments, fit.optimum.scales.sigma
    counts = np.maximum(segments.observed.sum(axis=(0, 2)), 1)
    power = np.sum((segments.samples * segments.observed) ** 2, axis=(0, 2)) / counts
    return bool((power < _LOW_SIGNAL * sigma**2).any())


_FAINT = 100.0  # energy over the noise: one peak of 1000 is mistaken for another with probability 1000 exp(-100 / 4) = 1e-8
_UNSEEN = 25.0  # energy over the noise: a rigid link explains the record to within five standard errors
_BY_PHASE = 4.0
"""Over the energy of the elongation: (value / error)^2 of a stiffness that the phase of a vibration determines better than
the size of the elongation, to which a force stretches the link in inverse proportion to it."""
_RIGID_SHIFT = 8.0  # standard errors
_LOW_RISE = 0.25  # of the rise of the cost that the curvature promises there


def undetermined_far_away(fit: LikelihoodFit, identified: Structure) -> tuple[str, ...]:
    """Names of the coefficients of faint links that may as well be far away.

    Those of a link whose elongation is not above the noise at all, where it has no coefficient that is known; without such a
    link those that may as well be eight standard errors away, tested one by one: all of a link whose elongation is faint, and
    those of elastic forces if only its own vibration determines them. Coefficients that other links share are not among
    them.

    Parameters
    ----------
    fit : LikelihoodFit
        The fit.
    identified : Structure
        The structure with the values of the fit.

    Returns
    -------
    tuple of str
        The names; none for a fit that did not converge.
    """
    system, energy = fit.segments.system, elongation_energy(fit)
    if not fit.converged:
        return ()
    estimated = {link for link, column, _ in system.interactions if fit.free[column]}
    own_energy = np.where(energy < np.inf, own_part(fit, estimated), 1.0) * energy
    if not (own_energy < _FAINT).any():
        return ()
    in_links: dict[int, list[int]] = {}
    for link, column, _ in system.interactions:
        in_links.setdefault(column, []).append(link)
    own = [column for column, links in sorted(in_links.items()) if (own_energy[links] < _FAINT).all()]
    free = [column for column in own if fit.free[column]]
    names, elastic = system.parameters.names, _elastic(identified)
    unseen = (energy < _UNSEEN) & system.wholly_unknown
    undetermined = [column for column in free if unseen[in_links[column]].all()]
    if not undetermined:
        information = fit.values**2 / np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny)
        tested = [
            column
            for column in free
            if (energy[in_links[column]] < _FAINT).all()
            or (names[column] in elastic and information[column] > _BY_PHASE * energy[in_links[column]].sum())
        ]
        variances = _covariance(fit).diagonal()
        undetermined = [
            column
            for column in tested
            if 0.0 < variances[column] < np.inf and not _profile_rises(fit, column, _RIGID_SHIFT, _LOW_RISE)
        ]
    return tuple(names[column] for column in undetermined)


def _elastic(structure: Structure) -> frozenset[str]:
    """Names of the coefficients on which the elastic forces of links depend: a frequency determines these alone."""
    return frozenset(
        f"{link.name}.{name}"
        for link in structure.links
        for name in set(link.coefficients).intersection(symbols(link.law.elastic))
    )


def elongation_energy(fit: LikelihoodFit) -> Floats:
    """(L,) sum of squares of each link's elongation about its mean, in units of the noise of the sensors at its ends.

    Rates and their noise are counted alike. Infinite for links of which an end has no sensor, or the force or a state has.
    """
    segments = fit.segments
    sensors, incidence = segments.sensors, segments.system.incidence
    if sensors.shapes is not None:  # points show modes, of which each link moves several
        return np.full(incidence.shape[1], np.inf)
    orbit, at, links = fit.misfit.trajectories, segments.at_samples, incidence.shape[1]
    energy, is_measured = np.zeros(links), np.zeros(links, dtype=bool)
    motions = (
        orbit.links[at, 0],
        orbit.links[at, 1],
        np.einsum("il,mik->mlk", incidence, orbit.accelerations[at]),
    )
    with_ends, variances = incidence != 0.0, fit.optimum.scales.sigma**2
    for kind, motion in zip((X, V, A), motions, strict=True):
        own, shown = np.full(len(incidence), np.inf), np.ones(len(incidence))
        chosen = sensors.kind == kind
        own[sensors.mass[chosen]] = variances[chosen]
        shown[sensors.mass[chosen]] = segments.observed[:, chosen].mean(axis=(0, 2))
        variance = np.where(with_ends, own[:, None], 0.0).sum(
            axis=0
        )  # infinite where an end has no such sensor
        present = np.where(with_ends, shown[:, None], 1.0).min(axis=0)
        energy += np.var(motion, axis=(0, 2)) * motion.shape[0] * motion.shape[2] * present / variance
        is_measured |= np.isfinite(variance)
    energy[~is_measured] = np.inf
    energy[sensors.mass[sensors.kind == F]] = np.inf
    energy[segments.system.state_links[sensors.mass[sensors.kind == S]]] = np.inf
    return energy


def own_part(fit: LikelihoodFit, links: Collection[int]) -> Floats:
    """(L,) part of the energy of some links' elongation that does not follow those of the others at one of its ends; else 1.

    It is what their elongations, cubes and rates leave of it by least squares, at the end where that is less.
    """
    system = fit.segments.system
    motion = fit.misfit.trajectories.links[fit.segments.at_samples]
    d, v = (motion[:, kind].transpose(2, 0, 1).reshape(-1, motion.shape[2]) for kind in (0, 1))
    d = d - d.mean(axis=0)
    touches = system.incidence != 0.0
    parts = np.ones(d.shape[1])
    for link in links:
        power = max(float(np.vdot(d[:, link], d[:, link])), np.finfo(float).tiny)
        for mass in np.flatnonzero(touches[:, link]):
            beside = np.setdiff1d(np.flatnonzero(touches[mass]), link)
            columns = np.column_stack([np.ones(len(d)), d[:, beside], v[:, beside], d[:, beside] ** 3])
            columns /= np.maximum(np.linalg.norm(columns, axis=0), np.finfo(float).tiny)
            left = d[:, link] - columns @ np.linalg.lstsq(columns, d[:, link], rcond=None)[0]
            parts[link] = min(parts[link], float(np.vdot(left, left)) / power)
    return parts
