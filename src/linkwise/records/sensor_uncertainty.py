"""How well the errors of a sensor are known: its gain, its offset and its delay."""

from __future__ import annotations

from dataclasses import dataclass
from math import isinf, isnan

from linkwise.errors import RecordError
from linkwise.records.channel import Channel
from linkwise.units import factor_to_si

COMMON = "common"  # in place of a channel: a gain that all sensors share


@dataclass(frozen=True)
class SensorUncertainty:
    """Standard deviations to which gain, offset and delay of a sensor are known beforehand.

    0 says that there is no such error, infinity that nothing is known of it. `identify` by maximum likelihood and `discover`
    find the errors with the laws, with these priors, and count them in every interval.

    Parameters
    ----------
    gain : float, optional
        Of the gain, relative: 0.01 for a calibration to 1 %.
    offset : float, optional
        Of the constant error, in the SI unit of the channel.
    delay : float, optional
        Of the delay, in s.

    Raises
    ------
    RecordError
        If one of them is negative or not a number.

    Examples
    --------
    >>> import linkwise as lw
    >>> from dataclasses import replace
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0).with_noise(30.0, seed=1)
    >>> record = replace(record, uncertainty={"x:m1": lw.records.SensorUncertainty(gain=0.01, offset=1e-4)})
    >>> fit = lw.identify(record, lw.bnes_chain(2).unknown("nes"))
    >>> [(error.channel, error.kind) for error in fit.sensor_errors]
    [('x:m1', 'offset'), ('x:m1', 'gain')]
    """

    gain: float = 0.0
    offset: float = 0.0
    delay: float = 0.0

    def __post_init__(self) -> None:
        for name in ("gain", "offset", "delay"):
            sigma = getattr(self, name)
            if isnan(sigma) or sigma < 0.0:
                raise RecordError(f"the standard deviation of a {name} must not be negative, got {sigma!r}")

    def __bool__(self) -> bool:
        return bool(self.gain or self.offset or self.delay)

    def described(self, channel: str, of_state: str = "") -> str:
        """Say what is known of the sensor of a channel.

        Parameters
        ----------
        channel : str
            The channel, or ``"common"``.
        of_state : str, optional
            The unit that a file stated of the channel, of a state of a link; the SI unit of a rotation.

        Returns
        -------
        str
            A sentence.
        """
        known = []
        for name in ("gain", "offset", "delay"):
            sigma = getattr(self, name)
            if isinf(sigma):
                known.append(f"its {name} is unknown")
            elif sigma:
                plain = {"gain": f"{100.0 * sigma:.3g} %", "delay": f"{sigma:.3g} s"}.get(name)
                size = plain or size_in_unit(sigma, Channel.parse(channel), of_state, digits=3)
                known.append(f"its {name} is known to {size}")
        return f"{'The gain that all sensors share' if channel == COMMON else channel}: {', '.join(known)}."


def size_in_unit(size: float, channel: Channel, of_state: str = "", *, digits: int = 6) -> str:
    """A size in SI with the unit of a channel; that of a state in the unit that a file stated, else with words for it."""
    unit = channel.unit
    if "?" not in unit:
        return f"{size:.{digits}g} {of_state or unit}"
    if not of_state:
        return f"{size:.{digits}g} in its SI unit"
    return f"{size / factor_to_si(of_state, '?'):.{digits}g} {of_state}"
