"""What the paper leaves open of its method, each choice by name: where a study puts its noise, and how a force is read.

Conventions say which quantities carry noise and how the derivatives are formed. The paper does not state either, and its Table
2 depends on both. Each convention turns the same noise-free record into the states that a regression uses. They differ by
orders of magnitude: differentiating a noisy displacement twice multiplies the noise by the square of the sampling rate, noise
in the columns of a library biases the coefficients in proportion to its variance (errors in variables), and noise in the
derivatives alone averages out.

Readings find the stiffness force of a link in a fit in monomials of all states, which has no links, and its error (the paper's
Eq. 8). The paper says "select the identified parameters and then reconstruct the nonlinear stiffness" (section 3, step 7)
without saying which; a `Reading` is one interpretation. All of them use the equation of the mass that carries this link alone
(a sink), m x'' = -f, where no other force acts.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from itertools import count
from typing import Literal, get_args

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, RecordError
from linkwise.estimates.curves import force_error
from linkwise.expression import polynomial
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.signals.states import States, differentiate
from linkwise.sindy.library import Monomials, tags
from linkwise.sindy.regression.regressor import RegressionFit

Convention = Literal["displacement", "states", "differenced", "derivatives"]

CONVENTIONS: tuple[Convention, ...] = get_args(Convention)
"""Where `noisy_states` can put its noise, by name (METHODS section 3)."""
MEANING: dict[Convention, str] = {
    "displacement": "noise on every displacement, velocities and accelerations by differentiating it (the paper's steps 2 "
    "and 3)",
    "states": "noise on every displacement and velocity, accelerations exact",
    "differenced": "noise on every displacement and velocity, accelerations by central differences of fourth order of the "
    "noisy velocity",
    "derivatives": "displacements and velocities exact, noise on every acceleration (the paper's Eq. 2)",
}


def noisy_states(
    record: Record,
    convention: Convention,
    snr_db: float,
    *,
    seed: int,
) -> States:
    """States of a noise-free simulated record with synthetic noise under a convention.

    White Gaussian noise is added to each channel that the convention names. Its variance is mean(x^2) 10^(-snr_db / 10) of
    that channel, and its samples depend on the seed and the name of the channel alone, so that conventions share them.

    Parameters
    ----------
    record : Record
        A record of ``simulate(..., sensors=("x", "v", "a"))`` without noise.
    convention : {"displacement", "states", "differenced", "derivatives"}
        "displacement" adds noise to x and derives v and a from it; "states" adds noise to x and v and leaves a exact;
        "differenced" adds noise to x and v and forms a by central differences of order 4 of the noisy v; "derivatives" adds
        noise to a and leaves x and v exact. With least squares and the reading "coefficients" of `monomial_force`,
        "differenced" comes nearest to the paper's Table 2.
    snr_db : float
        Signal-to-noise ratio in dB.
    seed : int
        Seed of the noise.

    Returns
    -------
    States
        Displacements in m, velocities in m/s and accelerations in m/s^2, each of shape (N, n).

    Raises
    ------
    RecordError
        If the record was measured, has noise or lacks a sensor, or the convention is unknown.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(
    ...     lw.bnes_chain(2), release={"v:m1": 1.0}, duration=1.0, rate=1000.0, sensors=("x", "v", "a")
    ... )
    >>> lw.sindy.noisy_states(record, "differenced", 30.0, seed=1).a.shape
    (1001, 2)
    """
    if convention not in CONVENTIONS:
        listed = "; ".join(f'"{name}": {meaning}' for name, meaning in MEANING.items())
        raise RecordError(f"unknown noise convention {convention!r}; choose from {listed}")
    _require_clean(record)
    noisy = {"displacement": "x", "states": "xv", "differenced": "xv", "derivatives": "a"}[convention]
    named = [name for name in record.responses if name[0] in noisy]
    noisy_record = record.select(named).with_noise(snr_db, seed=seed)
    if convention in ("displacement", "differenced"):
        channels = (*noisy_record.channels, *record.inputs)
        values = np.column_stack([noisy_record.values, *map(record.channel, record.inputs)])
        noisy_record = replace(record, channels=channels, values=values, uncertainty={})
        return differentiate(noisy_record, "spline" if convention == "displacement" else "differences")
    values = record.values.copy()
    values[:, [record.channels.index(name) for name in noisy_record.channels]] = noisy_record.values
    return differentiate(replace(record, values=values))


def _require_clean(record: Record) -> None:
    if record.simulated is None:
        message = "a study of noise needs a simulated record, whose noise-free motion is known; this one was measured"
        raise RecordError(message)
    added = [name for name, sigma in record.simulated.noise.items() if sigma > 0]
    if added:
        message = (
            "has noise already; give the record as it was simulated, since `noisy_states` adds the noise"
        )
        raise RecordError(message, channel=added[0])
    for mass in record.simulated.structure.mass_names:
        for kind in "xva":
            if f"{kind}:{mass}" not in record.channels:
                raise RecordError(
                    "is not in the record; displacement, velocity and acceleration of every mass are needed: "
                    'simulate with sensors=("x", "v", "a")',
                    channel=f"{kind}:{mass}",
                )


Reading = Literal["coefficients", "ends", "displacements"]

READINGS: tuple[Reading, ...] = get_args(Reading)
"""How `monomial_force` can read the force of a link from a monomial model."""


def monomial_force(
    fit: RegressionFit, structure: Structure, link: str, record: Record, *, reading: Reading = "coefficients"
) -> tuple[Floats, Floats]:
    """Stiffness force of a link that a monomial model implies, along the motion of a simulated record.

    Parameters
    ----------
    fit : RegressionFit
        A fit of `monomial_equations` for the masses of `record`.
    structure : Structure
        Gives the mass and the powers of the law.
    link : str
        Name of the link; one of its ends must be a mass that carries no other link.
    record : Record
        A simulated record without noise.
    reading : {"coefficients", "ends", "displacements"}, optional
        "coefficients": the powers of d in the law, each with the coefficient of that power of the sink's displacement (alpha
        from x2, beta from x2**3); terms in other displacements are ignored. "ends": all monomials in the displacements of the
        two ends of the link. "displacements": all monomials in the displacements of all masses.

    Returns
    -------
    elongation : array of shape (N,)
        Elongation of the link in m.
    force : array of shape (N,)
        Stiffness force in N.

    Raises
    ------
    IdentificationError
        If neither end of the link is a mass that carries no other link, the fit lacks the equation of that mass or a power of
        the law, or the reading is unknown.
    RecordError
        If the record was not simulated.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> fit = lw.sindy.LeastSquares().fit(lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=3))
    >>> elongation, force = lw.sindy.monomial_force(fit, chain, "nes1", record)
    >>> force.shape
    (2001,)
    """
    if reading not in READINGS:
        raise IdentificationError(f"unknown reading {reading!r}; choose from {', '.join(READINGS)}")
    if record.simulated is None:
        message = "the true motion of a link is known for a simulated record only; this one was measured"
        raise RecordError(message)
    chosen, truth = structure.link(link), record.simulated
    sink = _end_of_sink(structure, chosen)
    named = {mass: f"x{tag}" for mass, tag in zip(record.masses, tags(record.masses), strict=True)}
    terms = fit.terms(f"{named[sink]}''")
    d = structure.elongations(truth.displacement, truth.base)[:, structure.links.index(chosen)]
    sign = 1.0 if sink == chosen.between[0] else -1.0
    if reading == "coefficients":
        powers = _powers_of_law(chosen)
        names = [named[sink] + (f"**{power}" if power > 1 else "") for power in powers]
        absent = [name for name in names if name not in fit.names]
        if absent:
            raise IdentificationError(
                f"the law {chosen.law.text} of link {link} needs a column {absent[0]}, which the fit's library lacks; use a "
                "higher order"
            )
        columns = (sign * d[:, None]) ** np.array(powers)
    else:
        masses = [mass for mass in record.masses if reading == "displacements" or mass in chosen.between]
        library = Monomials(tuple(named[mass] for mass in masses), _library_order(fit, named[sink]))
        names, at = list(library.names), [truth.structure.mass_names.index(mass) for mass in masses]
        columns = library.evaluate(truth.displacement[:, at])
    # A constant force, such as a weight, is not a stiffness force: the constant column is left out.
    values = np.array([0.0 if name == "1" else terms.get(name, 0.0) for name in names])
    return d, np.asarray(-sign * structure.mass_values[structure.mass_names.index(sink)] * (columns @ values))


def monomial_nmse(
    fit: RegressionFit, structure: Structure, link: str, record: Record, *, reading: Reading = "coefficients"
) -> float:
    """Normalised mean square error in % of the stiffness force that a monomial model implies (the paper's Eq. 8).

    Parameters
    ----------
    fit : RegressionFit
        A fit of `monomial_equations` for the masses of `record`.
    structure : Structure
        The true structure.
    link : str
        Name of the link.
    record : Record
        A simulated record without noise.
    reading : {"coefficients", "ends", "displacements"}, optional
        As in `monomial_force`.

    Returns
    -------
    float
        100 mean((f - f_fit)^2) / var(f) along the motion, in %.

    Raises
    ------
    IdentificationError
        As `monomial_force`.
    RecordError
        If the record was not simulated or the true force is constant.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0, sensors=("x", "v", "a"))
    >>> fit = lw.sindy.LeastSquares().fit(lw.sindy.monomial_equations(lw.sindy.differentiate(record), order=3))
    >>> lw.sindy.monomial_nmse(fit, chain, "nes1", record) < 1e-12
    True
    """
    d, identified = monomial_force(fit, structure, link, record, reading=reading)
    return force_error(structure.link(link).force(d), identified, link)


def _end_of_sink(structure: Structure, link: Link) -> str:
    """The end of the link that carries no other link."""
    carried = Counter(end for joint in structure.links for end in joint.between)
    for end in link.between:
        if end in structure.mass_names and carried[end] == 1:
            return end
    raise IdentificationError(
        f"both ends of link {link.name} carry other links, so no equation of a monomial model contains its force alone; "
        "choose a link with a free end, or fit the columns of `link_columns`"
    )


def _powers_of_law(link: Link) -> list[int]:
    """The powers of d in the law at v = 0, the constant left out. Raises IdentificationError for another law."""
    monomials = polynomial(link.law.elastic, ("d",))
    if monomials is None:
        raise IdentificationError(
            f"the law {link.law.text} of link {link.name} is not a polynomial in d, so no monomials represent it; use "
            'reading="displacements"'
        )
    return sorted(power for (power,) in monomials if power)


def _library_order(fit: RegressionFit, variable: str) -> int:
    """The highest power of a variable in the fit's library."""
    return next(k for k in count(2) if f"{variable}**{k}" not in fit.names) - 1
