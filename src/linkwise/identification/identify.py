"""From a record and a structure with unknowns to the force law of every link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Literal

from linkwise.errors import IdentificationError
from linkwise.estimates.estimate import Estimate
from linkwise.likelihood.estimate import likelihood_estimate
from linkwise.likelihood.loss import Loss
from linkwise.model.structure import Structure
from linkwise.progress import Progress, silent
from linkwise.records.record import Record
from linkwise.sindy.estimate import PhysicsInformedSindy, sindy_estimate
from linkwise.weak.estimate import weak_estimate

IdentificationMethod = Literal["ml", "weak", "sindy"]
_METHODS = ("ml", "weak", "sindy")


def identify(
    record: Record | Sequence[Record],
    structure: Structure,
    *,
    method: IdentificationMethod | PhysicsInformedSindy = "ml",
    starts: Mapping[str, float] | None = None,
    offsets: Sequence[str] = (),
    gains: Sequence[str] = (),
    loss: Loss | None = None,
    progress: Progress = silent,
) -> Estimate:
    """The unknown coefficients and masses of `structure` from `record`, or from several records of it together ("ml").

    `method` "ml" (default, METHODS section 5: maximum likelihood on the raw samples), "weak" (section 4: no signal is
    differentiated, noise bias removed; milliseconds) or "sindy" (the paper's physics-informed SINDy;
    `PhysicsInformedSindy(...)` in its place says how).
    For "ml" only: `starts` of parameters by name (else the weak fit's), `offsets` and `gains` name channels with an unknown
    constant error or factor, `loss` is Gaussian() or, against outliers, Huber() or Student(). `progress` is told
    every step of "ml"; the others are done at once.

    Raises IdentificationError where the records cannot tell an unknown at all.
    """
    records = [record] if isinstance(record, Record) else list(record)
    options = method if isinstance(method, PhysicsInformedSindy) else PhysicsInformedSindy()
    method = "sindy" if isinstance(method, PhysicsInformedSindy) else method
    if method not in _METHODS:
        raise IdentificationError(f'"{method}" is no method; there are {", ".join(_METHODS)}')
    if not records:
        raise IdentificationError("there is no record to identify from")
    if not structure.parameters:
        raise IdentificationError(
            'there is nothing to identify, every coefficient is a number: write "unknown" for those to be found'
        )
    if method != "ml" and (len(records) > 1 or starts or offsets or gains or loss):
        raise IdentificationError(
            f'several records, starts, offsets, gains and a loss are for method "ml", not for "{method}"'
        )
    started = perf_counter()
    if method == "ml":
        estimate = likelihood_estimate(
            records, structure, starts=starts, offsets=offsets, gains=gains, loss=loss, progress=progress
        )
    elif method == "weak":
        estimate = weak_estimate(records[0], structure)
    else:
        estimate = sindy_estimate(records[0], structure, options)
    return replace(estimate, seconds=perf_counter() - started)
