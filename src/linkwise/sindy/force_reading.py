"""The stiffness force of a link as a fit in monomials of all states tells it, and its error (the paper's Eq. 8).

A library of monomials knows no links. The paper says "select the identified parameters and then reconstruct the nonlinear
stiffness" (section 3, step 7) and not which; what can be meant is a `Reading`. All of them take the equation of the mass
that only this link holds (a sink), m x'' = -f, where no other force stands in the way.
"""

from __future__ import annotations

from itertools import count
from typing import Literal, get_args

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import IdentificationError, RecordError
from linkwise.expression import polynomial
from linkwise.model.link import Link
from linkwise.model.structure import Structure
from linkwise.records.record import Record
from linkwise.sindy.monomials import Monomials, tags
from linkwise.sindy.regression.regressor import RegressionFit

Reading = Literal["coefficients", "ends", "displacements"]

READINGS: tuple[Reading, ...] = get_args(Reading)
"""How `monomial_force` can read the force of a link from a monomial model."""


def monomial_force(
    fit: RegressionFit, structure: Structure, link: str, record: Record, *, reading: Reading = "coefficients"
) -> tuple[Floats, Floats]:
    """Elongations d (N,) in m of the named link in the clean simulated `record`, and the stiffness force (N,) in N that `fit`
    finds along them.

    `fit` is one of `monomial_equations` for the masses of `record`; `structure` gives the mass and the law's powers.
    `reading`:

    - "coefficients": the law's own powers of d, each with the coefficient of that power of the sink's displacement: alpha
      from x2, beta from x2**3. What the terms in the other mass say is not asked.
    - "ends": all monomials in the displacements of the link's two ends, along the motion;
    - "displacements": all monomials in the displacements of all masses, along the motion.

    Raises IdentificationError where neither end of the link is a mass that this link alone holds, where the fit lacks its
    equation or power; RecordError for a record that was not simulated.
    """
    if reading not in READINGS:
        raise IdentificationError(f"{reading!r} is no reading of a force; there are {', '.join(READINGS)}")
    if record.simulated is None:
        raise RecordError(
            "the true motion of a link is known of a simulated record only; this one was measured"
        )
    one, truth = structure.link(link), record.simulated
    sink = _sink(structure, one)
    named = {mass: f"x{tag}" for mass, tag in zip(record.masses, tags(record.masses), strict=True)}
    terms = fit.terms(f"{named[sink]}''")
    d = structure.elongations(truth.displacement, truth.base)[:, structure.links.index(one)]
    sign = 1.0 if sink == one.between[0] else -1.0
    if reading == "coefficients":
        powers = _powers(one)
        names = [named[sink] + (f"**{power}" if power > 1 else "") for power in powers]
        absent = [name for name in names if name not in fit.names]
        if absent:
            raise IdentificationError(
                f"the law {one.law.text} of link {link} needs a column {absent[0]}, and the fit's library has none; take a "
                "higher order"
            )
        columns = (sign * d[:, None]) ** np.array(powers)
    else:
        masses = [mass for mass in record.masses if reading == "displacements" or mass in one.between]
        library = Monomials(tuple(named[mass] for mass in masses), _order(fit, named[sink]))
        names = list(library.names)
        columns = library.evaluate(
            truth.displacement[:, [truth.structure.mass_names.index(mass) for mass in masses]]
        )
    # What does not change with the motion is a weight, no stiffness: the constant takes no part.
    values = np.array([0.0 if name == "1" else terms.get(name, 0.0) for name in names])
    return d, np.asarray(-sign * structure.mass_values[structure.mass_names.index(sink)] * (columns @ values))


def monomial_nmse(
    fit: RegressionFit, structure: Structure, link: str, record: Record, *, reading: Reading = "coefficients"
) -> float:
    """The paper's Eq. (8) in % for one link: the force that `monomial_force` finds against that of `structure`, the truth.

    Raises what `monomial_force` raises, and RecordError where the true force does not vary.
    """
    d, found = monomial_force(fit, structure, link, record, reading=reading)
    force = structure.link(link).force(d)
    variance = float(np.var(force))
    if variance == 0.0:
        raise RecordError(
            f'the true force of link "{link}" does not vary over the record, so no relative error exists'
        )
    return float(100.0 * np.mean((force - found) ** 2) / variance)


def _sink(structure: Structure, link: Link) -> str:
    """The end of the link that holds on to nothing else."""
    for end in link.between:
        if end in structure.mass_names and sum(end in other.between for other in structure.links) == 1:
            return end
    raise IdentificationError(
        f"both ends of link {link.name} hold further links, so no equation of a monomial library tells its force alone; read "
        "a link with a free end, or fit the columns of the links"
    )


def _powers(link: Link) -> list[int]:
    """The powers of d in the law at v = 0, the constant left out. Raises IdentificationError for another law."""
    found = polynomial(link.law.elastic, ("d",))
    if found is None:
        raise IdentificationError(
            f"the law {link.law.text} of link {link.name} is no polynomial in d, so no monomials stand for it; read "
            'reading="displacements"'
        )
    return sorted(power for (power,) in found if power)


def _order(fit: RegressionFit, variable: str) -> int:
    """The highest power of a variable in the fit's library."""
    return next(k for k in count(2) if f"{variable}**{k}" not in fit.names) - 1
