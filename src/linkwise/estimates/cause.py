"""What would explain a part of what an estimate leaves: errors of sensors, masses and applied forces, and missing terms."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Cause:
    """An error that would explain a part of what a fit leaves.

    Attributes
    ----------
    kind : str
        ``"gain"``, ``"offset"``, ``"drift"``, ``"delay"`` or ``"crosstalk"`` of a channel, a ``"filter"`` that all of them
        share, ``"mass"``, the ``"frequency"`` of a mode of a host or its ``"shape"`` at a point, ``"force gain"`` or ``"force
        delay"`` of an applied force, ``"input noise"`` of its channel or that of the base, an ``"ambient"`` force on a mass, a
        missing ``"term"`` of a link, a missing ``"link"`` between two masses or to the ground, or a stated value, ``"prior"``,
        that the records contradict.
    where : str
        The channel, mass or link; of a missing link the two that it joins, ``"m2-ground"``.
    size : float
        The error, in `unit`: relative for gains, masses and frequencies, the root mean square of the force for a term or a
        link, half the square of the time constant for a filter, the standard deviation of noise, the spectral density of an
        ambient force.
    unit : str
        SI unit of `size`, ``"1"`` for a ratio.
    gain : float
        What it would take off -2 log likelihood.
    standard_error : float
        Of `size`.
    term : str
        The form of a missing term, or of the law of a missing link, else empty.
    source : str
        The channel that crosstalk comes from, or the mode of a shape, else empty.
    share : float
        Of a missing term: its part of the force in its link, both root mean squares.
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
        size, place = abs(self.size), self.where
        match self.kind:
            case "term":
                return f"a force like {self.term} in {place} of {size:.3g} N"
            case "link":
                return f"a link {place} with a force like {self.term} of {size:.3g} N"
            case "gain":
                return f"a gain of {place} that is off by {100.0 * self.size:+.3g} %"
            case "crosstalk":
                return f"{100.0 * self.size:+.3g} % of {self.source} in {place}"
            case "filter":
                corner = 1.0 / (2.0 * np.pi * np.sqrt(2.0 * size))
                return f"a filter of {place}, as a low pass of first order at {corner:.3g} Hz"
            case "frequency":
                return f"a frequency of {place} that is off by {100.0 * self.size:+.3g} %"
            case "shape":
                return f"a shape of {self.source} at {place} that is off by {100.0 * self.size:+.3g} %"
            case "mass":
                return f"a mass of {place} that is off by {100.0 * self.size:+.3g} %"
            case "force gain":
                return f"a scale of {place} that is off by {100.0 * self.size:+.3g} %"
            case "prior":
                side = "above" if self.size > 0.0 else "below"
                sigma = f"{self.standard_error:.3g}"
                return (
                    f"{place} {size:.3g} {self.unit} {side} the value that is stated with a sigma of {sigma}"
                )
            case "delay" | "force delay":
                return f"a delay of {1e3 * self.size:.3g} ms in {place}{self.remark and f' ({self.remark})'}"
            case "input noise":
                return f"noise of {place} of {size:.3g} {self.unit}{self.remark and f' ({self.remark})'}"
            case "ambient":
                return f"an ambient force on {place} of {size:.3g} {self.unit}{self.remark and f' ({self.remark})'}"
            case "drift":
                return f"a drift of {self.size:.3g} {self.unit} in {place}"
        return f"an offset of {self.size:.3g} {self.unit} in {place}"

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
