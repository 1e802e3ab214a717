"""A host from matrices, with what their reduction leaves out."""

from __future__ import annotations

from dataclasses import dataclass

from linkwise.model.host import Host


@dataclass(frozen=True, eq=False)
class HostReduction:
    """A host from matrices, and what the reduction leaves out.

    Attributes
    ----------
    host : Host
        The kept modes and the residual attachment modes.
    kept : int
        The number of modes that are natural modes of the matrices.
    band : float
        Frequency in Hz at which `error` is computed: half that of the first mode that was left out, or up to a tenth less
        where a kept mode is in resonance.
    error : float
        Relative error of the receptances between the points there, by their Frobenius norm; less at lower frequencies, but
        for antiresonances.
    damping_coupling : float
        Largest motion of one mode, as a part of that of another at resonance, that a damping matrix causes which is not
        diagonal in the modes [1]_; infinite between modes of one frequency. Pairs of modes with more than 0.1 % are in the
        `damping` of the host.
    total_mass : float or None
        Mass in kg of the model, where its degrees of freedom are named.
    massless : int
        Degrees of freedom without mass, which follow the others statically.

    References
    ----------
    .. [1] T. K. Hasselman, AIAA J. 14, 1627 (1976).

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> from scipy.sparse import csc_array
    >>> stiffness = csc_array(1e4 * (2.0 * np.eye(9) - np.eye(9, k=1) - np.eye(9, k=-1)))
    >>> reduced = lw.reduce_host("rod", csc_array(0.1 * np.eye(9)), stiffness, {"mid": 5}, keep=2)
    >>> round(reduced.band, 1)
    22.8
    """

    host: Host
    kept: int
    band: float
    error: float
    damping_coupling: float = 0.0
    total_mass: float | None = None
    massless: int = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know before the host is used: what was left out, and what may be wrong with the matrices."""
        notes = [
            f"{self.kept} modes and {len(self.host.modes) - self.kept} residual ones; at {self.band:.4g} Hz the receptances "
            f"at the points are off by {100.0 * self.error:.2g} %"
        ]
        pairs = sum(first != second for first, second in self.host.damping)
        if pairs:
            notes.append(
                f"the damping matrix couples {pairs} {'pair' if pairs == 1 else 'pairs'} of modes, one of which moves by "
                f"up to {100.0 * self.damping_coupling:.3g} % of the other at resonance"
            )
        free = sum(mode.frequency.value == 0.0 for mode in self.host.modes)
        if free:
            notes.append(
                f"{free} {'mode is' if free == 1 else 'modes are'} at 0 Hz: the model is free to move; if the structure is "
                "not, take matrices with its boundary conditions"
            )
        if self.massless:
            notes.append(
                f"{self.massless} degrees of freedom have no mass and follow the others statically; if they should have mass, "
                "the mass matrix is not complete"
            )
        if self.total_mass is not None:
            notes.append(f"the model weighs {self.total_mass:.4g} kg, its matrices being taken in SI units")
        return tuple(notes)
