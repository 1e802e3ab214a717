"""How far an identified force is from the true one, where there is one."""

from __future__ import annotations

import numpy as np

from linkwise.arrays import Floats
from linkwise.errors import RecordError, expect
from linkwise.estimates.curves import force_error
from linkwise.likelihood.rigs.problem import LinkPath
from linkwise.model.excitation import Sampled
from linkwise.model.structure import BASE, GROUND, Link
from linkwise.records.record import Record

_SUBSTEPS = 10  # between samples, of links with memory: right to 1e-4 at 20 samples a period


def nmse(true: Link, estimated: Link, record: Record) -> float:
    """Compute the normalised mean square error of an identified force.

    It is the mean square of the difference of both stiffness forces (v = 0) over the variance of the true one, at the
    elongations of a record: the true ones of a simulated record, those of the displacements of a measured one. If one of the
    links has memory, the whole forces are compared: both are driven by the elongations, from the true states at the start of
    a simulated record, and from states of 0 otherwise.

    Parameters
    ----------
    true : Link
        The link with its true law.
    estimated : Link
        The link with the identified law.
    record : Record
        The motion over which both are compared.

    Returns
    -------
    float
        The error in %.

    Raises
    ------
    RecordError
        If an end of the link has no displacement in the record, the true force does not vary, or a state of a link with memory
        runs away.
    SimulationError
        If the elongation of a link with memory has gaps.

    References
    ----------
    The paper, Eq. 8.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=0.5, rate=1000.0)
    >>> weaker = lw.bnes_chain(2, alpha=-99.0)
    >>> bool(0.0 < lw.nmse(chain.link("nes1"), weaker.link("nes1"), record) < 0.1)
    True
    """
    expect("nmse(true, estimated, record): true", true, Link)
    expect("nmse(true, estimated, record): estimated", estimated, Link)
    expect("nmse(true, estimated, record): record", record, Record)
    forces = _forces_with_memory if true.law.states or estimated.law.states else _stiffness_forces
    return force_error(*forces(true, estimated, record), true.name)


def _stiffness_forces(true: Link, estimated: Link, record: Record) -> tuple[Floats, Floats]:
    """(N',) N of both links at rest, at the elongations and signals of the samples where both ends were seen."""
    d = _elongation(true, record)
    seen = np.isfinite(d)
    named = {*true.law.signals, *estimated.law.signals}
    signals = {name: record.channel(f"signal:{name}")[seen] for name in named}
    return true.force(d[seen], states=signals), estimated.force(d[seen], states=signals)


def _forces_with_memory(true: Link, estimated: Link, record: Record) -> tuple[Floats, Floats]:
    """(N,) N of both links along the motion of one, their states by the trapezoidal rule between samples."""
    motion = Sampled(0.0, record.rate, _elongation(true, record))
    step = record.step / _SUBSTEPS
    nodes = np.minimum(step * np.arange(_SUBSTEPS * (len(record) - 1) + 1), motion.end)
    d, v = motion.value(nodes), motion.derivative(nodes)
    states = {} if record.simulated is None else record.simulated.states
    forces = []
    for link in (true, estimated):
        start = [float(states.get(f"{true.name}.{name}", [0.0])[0]) for name in link.law.states]
        path = LinkPath.of(link.law, link.values, d, v, step, np.array(start))
        if not path.converged:
            message = f'a state of link "{link.name}" runs away along the motion of the record, so that its force has no error'
            raise RecordError(message)
        forces.append(path.force()[::_SUBSTEPS])
    return forces[0], forces[1]


def _elongation(link: Link, record: Record) -> Floats:
    """(N,) elongations of one link."""
    return np.asarray(_displacement(link.between[0], record) - _displacement(link.between[1], record))


def _displacement(end: str, record: Record) -> Floats:
    truth = record.simulated
    if end == GROUND:
        return np.zeros(len(record))
    if truth is not None and end == BASE and truth.base is not None:
        return truth.base
    if truth is not None and end in truth.structure.topology.index and end != BASE:
        return np.asarray(truth.displacement @ truth.structure.topology.row(end))
    return record.channel(f"x:{end}")
