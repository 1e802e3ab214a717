"""Frequencies of a host that explain the records in place of links between its points and to the ground.

A frequency that is stated a few percent wrong is imitated by springs between points of the host: so well that a local model
about these springs, which are many standard errors from zero, cannot say what a fit without them would find. Here it is made,
with all frequencies of the hosts unknown in place of such links.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from linkwise.discovery.result import CERTAIN
from linkwise.discovery.rival_errors import RivalError
from linkwise.discovery.selection import Selection, TermSearch, cost_of, leaves_only_noise
from linkwise.errors import IdentificationError
from linkwise.model.link import GROUND, Link
from linkwise.model.names import Name

_FREQUENCY = "frequency"
_CEILING, _STEPS = 1.5, 40  # chi-square and steps at which a fit ends that does not explain the records


def rival_frequencies(search: TermSearch, selection: Selection) -> tuple[RivalError, ...]:
    """The error of the frequency that moves farthest, in its errors, where frequencies do as well as links on hosts alone.

    None without such links in a selection that leaves only noise.
    """
    structure = selection.structure
    ends = {*structure.points, GROUND}
    on_hosts = {
        pair.name for pair in search.candidates.pairs if not pair.stated and ends.issuperset(pair.between)
    }
    names = [parameter.name for parameter in structure.parameters]
    replaced = tuple(k for k, name in enumerate(names) if name.owner in on_hosts)
    links = [structure.link(name) for name in sorted(structure.modes)]
    modes = [Name(link.name, _FREQUENCY) for link in links if _is_stated(link)]
    if not (replaced and modes and selection.settled and leaves_only_noise(selection.fit)):
        return ()
    remaining = selection.chosen - {names[k] for k in replaced}
    values = dict(zip(names, selection.fit.values.tolist(), strict=True))
    values |= {name: float(structure.coefficient(name).value or 0.0) for name in modes}
    try:
        freed = search.candidates.structure(remaining).unknown(*modes)
        theta = np.array([values[parameter.name] for parameter in freed.parameters])
        options = replace(
            search.sensors, model_error=False, ceiling=_CEILING, steps=_STEPS, progress=search.progress
        )
        fit = search.fit(freed, theta, None, options)
    except (IdentificationError, np.linalg.LinAlgError):
        return ()
    if not leaves_only_noise(fit):
        return ()
    penalty, inside = selection.penalty, [k for k in range(len(names)) if k not in replaced]
    criterion = cost_of(fit, selection.noise) + penalty.total(inside) + penalty.term * len(modes)
    excess = criterion - selection.criterion(selection.noise)
    if excess >= CERTAIN:
        return ()
    place = {parameter.name: number for number, parameter in enumerate(freed.parameters)}
    deviations = np.sqrt(np.maximum(fit.covariance.diagonal(), np.finfo(float).tiny))
    changes = {name: float(fit.values[place[name]]) - values[name] for name in modes}
    most = max(modes, key=lambda name: abs(changes[name]) / deviations[place[name]])
    size = changes[most] / values[most]
    return (RivalError(_FREQUENCY, most.owner, size, replaced, float(excess)),)


def _is_stated(mode: Link) -> bool:
    """Whether the frequency of a mode is a number, other than 0."""
    frequency = mode.coefficients.get(_FREQUENCY)
    return frequency is not None and frequency.known and bool(frequency.value)
