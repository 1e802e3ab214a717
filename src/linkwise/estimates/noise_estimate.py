"""Noise of one channel, as an estimate reports it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from linkwise.records.channel import Channel
from linkwise.records.record import Record


@dataclass(frozen=True)
class NoiseEstimate:
    """Noise of a channel.

    Attributes
    ----------
    sigma : float
        Standard deviation in the SI unit of the channel.
    unit : str
        The unit.
    snr_db : float
        Signal-to-noise ratio in dB, of the mean square of the motion to that of the noise.

    Examples
    --------
    >>> import linkwise as lw
    >>> chain = lw.bnes_chain(2)
    >>> record = lw.simulate(chain, release={"v:m1": 1.0}, duration=1.0, rate=1000.0).with_noise(40.0, seed=1)
    >>> noise = lw.identify(record, chain.unknown("nes"), method="weak").noise["x:m1"]
    >>> noise.unit, round(noise.snr_db)
    ('m', 40)
    """

    sigma: float
    unit: str
    snr_db: float

    @classmethod
    def of(cls, record: Record, name: str, sigma: float, unit: str | None = None) -> NoiseEstimate:
        """Noise of a channel of a record.

        Parameters
        ----------
        record : Record
            The record.
        name : str
            Name of the channel.
        sigma : float
            Standard deviation of the noise in its SI unit.
        unit : str, optional
            That unit, where it is not the one of the channel's kind: of a state of a link.

        Returns
        -------
        NoiseEstimate
            The noise.
        """
        noise = cls.from_power(float(np.nanmean(record.channel(name) ** 2)), name, sigma)
        return noise if unit is None else replace(noise, unit=unit)

    @classmethod
    def from_power(cls, power: float, name: str, sigma: float) -> NoiseEstimate:
        """Noise of a channel of known mean square.

        Parameters
        ----------
        power : float
            Mean square of the samples, noise included.
        name : str
            Name of the channel.
        sigma : float
            Standard deviation of the noise in its SI unit.

        Returns
        -------
        NoiseEstimate
            The noise.
        """
        motion = power - sigma**2
        ratio = (
            10.0 * np.log10(motion / sigma**2)
            if sigma > 0.0 and motion > 0.0
            else (np.inf if sigma == 0.0 else -np.inf)
        )
        return cls(float(sigma), Channel.parse(name).unit, float(ratio))
