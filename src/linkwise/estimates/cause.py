"""What would explain a part of what an estimate leaves: errors of sensors, masses and applied forces, and missing terms."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from linkwise.model.host_damping import in_words
from linkwise.registry import Registry

DEGREES = float(np.degrees(1.0))
"""By which an angle in deg is too large where it is taken for one in rad."""


@dataclass(frozen=True)
class Cause:
    """An error that would explain a part of what a fit leaves.

    Attributes
    ----------
    kind : str
        ``"gain"``, ``"offset"``, ``"drift"``, ``"delay"`` or ``"crosstalk"`` of a channel, a ``"filter"`` that all of them
        share, the wrong ``"sign"`` of a channel, a ``"unit"`` that is another one, two channels that are ``"swapped"``, a
        ``"high pass"``, ``"clipped"`` samples, ``"mass"``, the ``"frequency"`` of a mode of a host or its ``"shape"`` at a
        point, a ``"mode"`` or ``"damping between modes"`` that a host lacks, ``"force gain"`` or ``"force delay"`` of an
        applied force, ``"input noise"`` of its channel or that of the base, an ``"ambient"`` force on a mass, one that is a
        ``"coloured force"`` where white ones were assumed, ``"correlated forces"`` on two masses, an ``"unsteady force"``
        whose level changes with time, a ``"change"`` of a coefficient at one moment, a missing ``"term"`` of a link, a
        missing ``"link"`` between two masses or to the ground, or a stated value, ``"prior"``, that the records contradict.
    where : str
        The channel, mass or link; of a missing link the two that it joins, ``"m2-ground"``.
    size : float
        The error, in `unit`: relative for gains, masses and frequencies, of a force what acts over what its channel shows,
        its delay behind that, the root mean square of the force for a term or a link, half the square of the time constant for
        a filter, how many times too large values in another unit are, the corner of a high pass, the frequency of a mode that
        is lacking, the number of clipped samples, 0 for a sign and for channels that are swapped, the standard deviation of
        noise, the spectral density of an ambient force, the root mean square of what that of a coloured one departs from its
        mean by, and the square of that of an unsteady one, the correlation of two forces, what a coefficient changes by.
    unit : str
        SI unit of `size`, ``"1"`` for a ratio.
    gain : float
        What it would take off -2 log likelihood.
    standard_error : float
        Of `size`; 0 for errors of a whole channel, whose size is no small one.
    term : str
        The form of a missing term, or of the law of a missing link, else empty.
    source : str
        The channel that crosstalk comes from, the other one of two that are swapped or correlated, the mode of a shape, or
        the moment of a change, else empty.
    share : float
        Of a missing term: its part of the force in its link, both root mean squares; of a mode that is lacking: the part of
        the power that is left in the sensors of its host that it explains.
    remark : str
        What else looks like it, else empty.
    shift : float
        The largest change of a coefficient that it would make, to first order, in standard errors of that coefficient.
    shifted : str
        The coefficient with this change.
    overturned : tuple of str
        The coefficients that differ from zero by more than two standard errors, and beside it would not, or have the other
        sign.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> values = record.values.copy()
    >>> values[:, record.channels.index("x:m2")] *= 1.05
    >>> wrong = lw.Record(record.start, record.rate, record.channels, values)
    >>> fit = lw.identify(wrong, chain.unknown("nes"), method="ml")
    >>> fit.diagnosis[0].kind, fit.diagnosis[0].where
    ('gain', 'x:m2')
    """

    kind: str
    where: str
    size: float
    unit: str
    gain: float
    standard_error: float
    term: str = ""
    source: str = ""
    share: float = 0.0
    remark: str = ""
    shift: float = 0.0
    shifted: str = ""
    overturned: tuple[str, ...] = ()

    @property
    def is_instrument(self) -> bool:
        """Whether it lies in what was recorded or stated, not in a law."""
        return self.kind not in ("term", "link")

    @property
    def description(self) -> str:
        """In words, with its size."""
        return CAUSE_KINDS.lookup(self.kind).describe(self)

    def to_dict(self) -> dict[str, str | float]:
        """What result.json holds of it.

        Returns
        -------
        dict
            Its part of result.json.
        """
        return {
            "cause": self.kind if not self.term else f"term {self.term}",
            "where": self.where,
            "size": self.size,
            "unit": self.unit,
            "gain": self.gain,
            "message": f"{self.description} would lower -2 log likelihood by {self.gain:.3g}",
        }


@dataclass(frozen=True)
class CauseKind:
    """A kind of cause: its description, the `unit` of its size, "" for that of its channel, and whether it is `relative`.

    A relative size is that of an error of a calibration, which is small where the first order holds.
    """

    describe: Callable[[Cause], str]
    unit: str = ""
    relative: bool = False


def _off(subject: str, *, relative: bool = True) -> CauseKind:
    """Something of the place that is off by a part of itself."""
    return CauseKind(lambda cause: f"{subject}{cause.where} that is off by {_percent(cause)}", "1", relative)


def _noise(source: str) -> CauseKind:
    """A random force or motion, by its place, size and what else looks like it."""
    return CauseKind(
        lambda cause: f"{source} {cause.where} of {abs(cause.size):.3g} {cause.unit}{_remarked(cause)}"
    )


def _late(cause: Cause) -> str:
    return f"a delay of {1e3 * cause.size:.3g} ms in {cause.where}{_remarked(cause)}"


def _other_force(cause: Cause) -> str:
    side = "larger" if cause.size > 0.0 else "smaller"
    return f"a force {100.0 * abs(cause.size):.3g} % {side} than {cause.where} shows"


def _late_force(cause: Cause) -> str:
    side = "later" if cause.size > 0.0 else "earlier"
    return f"a force {1e3 * abs(cause.size):.3g} ms {side} than {cause.where} shows{_remarked(cause)}"


def _stated(cause: Cause) -> str:
    side, sigma = "above" if cause.size > 0.0 else "below", f"{cause.standard_error:.3g}"
    return f"{cause.where} {abs(cause.size):.3g} {cause.unit} {side} the value that is stated with a sigma of {sigma}"


def _low_pass(cause: Cause) -> str:
    corner = 1.0 / (2.0 * np.pi * np.sqrt(2.0 * abs(cause.size)))
    return f"a filter of {cause.where}, as a low pass of first order at {corner:.3g} Hz{_remarked(cause)}"


def _in_other_unit(cause: Cause) -> str:
    large = cause.size >= 1.0
    times, side = f"{cause.size if large else 1.0 / cause.size:g}", "large" if large else "small"
    examples = {f"{1000.0:g}": ", as mm taken for m", f"{DEGREES:g}": ", as deg taken for rad"}
    example = examples.get(times, "") if large and cause.where.startswith("x:") else ""
    return f"another unit of {cause.where}, values {times} times too {side}{example}"


def _clipped(cause: Cause) -> str:
    return f"{cause.size:.0f} clipped sample{'' if cause.size == 1.0 else 's'} of {cause.where}"


def _in_channel(error: str) -> CauseKind:
    """What is added to a channel, in its unit."""
    return CauseKind(lambda cause: f"{error} of {cause.size:.3g} {cause.unit} in {cause.where}")


def _percent(cause: Cause) -> str:
    return f"{100.0 * cause.size:+.3g} %"


def _remarked(cause: Cause) -> str:
    return f" ({cause.remark})" if cause.remark else ""


CAUSE_KINDS: Registry[CauseKind] = Registry(
    "kind of cause",
    {
        "gain": _off("a gain of "),
        "offset": _in_channel("an offset"),
        "drift": _in_channel("a drift"),
        "delay": CauseKind(_late, unit="s"),
        "crosstalk": CauseKind(
            lambda cause: f"{_percent(cause)} of {cause.source} in {cause.where}", unit="1", relative=True
        ),
        "filter": CauseKind(_low_pass, unit="s^2"),
        "sign": CauseKind(lambda cause: f"the wrong sign of {cause.where}", unit="1"),
        "unit": CauseKind(_in_other_unit, unit="1"),
        "swapped": CauseKind(
            lambda cause: f"{cause.where} and {cause.source} in each other's place", unit="1"
        ),
        "high pass": CauseKind(
            lambda cause: f"a high pass of {cause.where} at {cause.size:.3g} Hz, as AC coupling is", unit="Hz"
        ),
        "clipped": CauseKind(_clipped, unit="1"),
        "mass": _off("a mass of "),
        "coefficient": _off("", relative=False),
        "frequency": _off("a frequency of ", relative=False),
        "damping": _off("a damping of ", relative=False),
        "damping between modes": CauseKind(
            lambda cause: f"damping of {cause.size:.3g} {cause.unit} {in_words(cause.where)}", unit="N s/m"
        ),
        "shape": CauseKind(
            lambda cause: f"a shape of {cause.source} at {cause.where} that is off by {_percent(cause)}",
            unit="1",
            relative=True,
        ),
        "mode": CauseKind(
            lambda cause: f"a mode near {cause.size:.3g} Hz that the host {cause.where} lacks", unit="Hz"
        ),
        "force gain": CauseKind(_other_force, unit="1", relative=True),
        "force delay": CauseKind(_late_force, unit="s"),
        "input noise": _noise("noise of"),
        "ambient": _noise("an ambient force on"),
        "coloured force": CauseKind(
            lambda cause: f"an ambient force on {cause.where} that is not white{_remarked(cause)}", unit="1"
        ),
        "correlated forces": CauseKind(
            lambda cause: (
                f"a correlation of {cause.size:.2g} between the ambient forces on {cause.where} and {cause.source}"
            ),
            unit="1",
        ),
        "unsteady force": CauseKind(
            lambda cause: (
                f"an ambient force on {cause.where} whose level changes with time{_remarked(cause)}"
            ),
            unit="1",
        ),
        "change": CauseKind(
            lambda cause: (
                f"a change of {cause.where} by {cause.size:+.3g} {cause.unit} near {cause.source}{_remarked(cause)}"
            )
        ),
        "prior": CauseKind(_stated),
        "term": CauseKind(
            lambda cause: (
                f"a force like {cause.term} in {cause.where} of {abs(cause.size):.3g} {cause.unit}{_remarked(cause)}"
            )
        ),
        "link": CauseKind(
            lambda cause: (
                f"a link {cause.where} with a force like {cause.term} of {abs(cause.size):.3g} {cause.unit}"
            )
        ),
    },
)
"""What a diagnosis may name."""
