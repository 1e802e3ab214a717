"""The result of an inspection: its channels and its alerts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from linkwise.argument_types import checked
from linkwise.display import JudgedView, as_text
from linkwise.errors import RecordError
from linkwise.inspection.alert import Alert
from linkwise.inspection.levels.result import LevelComparison
from linkwise.records.record import Record
from linkwise.verdict import Verdict


@dataclass(frozen=True)
class ChannelSummary:
    """What a channel is and holds.

    Attributes
    ----------
    name, unit : str
        The channel and its SI unit.
    record : str
        The record, by its source.
    samples, missing : int
        Number of samples that there are, and of those that are missing.
    rate : float
        Sampling rate in Hz.
    minimum, maximum, rms : float or None
        Range, and root mean square deviation from the mean; None without samples.
    noise : float or None
        Standard deviation of the noise, stated or estimated; None where it cannot be estimated.
    snr_db : float or None
        Ratio of motion to noise in dB; None without motion or noise.
    step : float or None
        Quantisation step; None where there is none.
    bits : float or None
        Base-2 logarithm of the number of steps in the range.
    highest_frequency : float or None
        Frequency in Hz below which lie 99 % of the power of the motion.
    samples_per_period : float or None
        Samples in a period of that frequency.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0)
    >>> summary = lw.inspect(record.with_noise(40.0, seed=1)).channel("x:m1")
    >>> summary.samples, summary.unit, round(summary.snr_db)
    (2001, 'm', 40)
    """

    name: str
    unit: str
    record: str
    samples: int
    missing: int
    rate: float
    minimum: float | None
    maximum: float | None
    rms: float | None
    noise: float | None
    snr_db: float | None
    step: float | None
    bits: float | None
    highest_frequency: float | None
    samples_per_period: float | None

    def to_dict(self) -> dict[str, Any]:
        """What the JSON of an inspection holds of it.

        Returns
        -------
        dict
            Its part of the JSON of an inspection, all but the name.
        """
        return {name: value for name, value in vars(self).items() if name != "name"}


@dataclass(frozen=True, repr=False)
class Inspection(JudgedView):
    """What the channels of records hold, and what is wrong with them.

    Attributes
    ----------
    records : tuple of Record
        The records.
    channels : tuple of ChannelSummary
        The channels of all records.
    alerts : tuple of Alert
        What is wrong, worst first; empty where nothing is.
    levels : LevelComparison or None
        What the records show of linearity, if they are one test at several levels and were compared.

    See Also
    --------
    inspect : Make one.

    Examples
    --------
    >>> import linkwise as lw
    >>> record = lw.simulate(lw.bnes_chain(2), release={"v:m1": 1.0}, duration=2.0, rate=1000.0)
    >>> found = lw.inspect(record.with_noise(20.0, seed=1))
    >>> found.alerts, found.trusted
    ((), True)
    >>> round(found.channel("x:m1").snr_db)
    20
    """

    records: tuple[Record, ...]
    channels: tuple[ChannelSummary, ...]
    alerts: tuple[Alert, ...]
    levels: LevelComparison | None = None

    def __str__(self) -> str:
        return as_text(self)

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(alert.kind for alert in self.alerts)) or "no alerts"
        return f"Inspection of {len(self.records)} records, {len(self.channels)} channels: {kinds}"

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether something is wrong with a channel, and the verdict on levels if these were compared."""
        channels = Verdict.CHANNELS_IN_DOUBT if self.alerts else Verdict.NOTHING_WRONG_SEEN
        return (channels, *(() if self.levels is None else self.levels.verdicts))

    @checked
    def channel(self, name: str) -> ChannelSummary:
        """What a channel holds, in the first record that has it.

        Parameters
        ----------
        name : str
            Name of the channel.

        Returns
        -------
        ChannelSummary
            What it holds.

        Raises
        ------
        RecordError
            If no record has the channel.
        """
        for summary in self.channels:
            if summary.name == name:
                return summary
        listed = ", ".join(dict.fromkeys(summary.name for summary in self.channels))
        raise RecordError(f"is not in the record; the channels are {listed}", channel=name)

    @checked
    def channels_of(self, number: int) -> tuple[ChannelSummary, ...]:
        """What the channels of one record hold.

        Parameters
        ----------
        number : int
            Place of the record in `records`, from 0.

        Returns
        -------
        tuple of ChannelSummary
            One for each channel.
        """
        label = labels(self.records)[number]
        return tuple(summary for summary in self.channels if summary.record == label)

    def to_dict(self) -> dict[str, Any]:
        """The inspection as plain data.

        Returns
        -------
        dict
            "verdicts" and "trusted", "channels" by name, "alerts" worst first, "records", and "levels" where these were
            compared; of several records "channels" holds each channel as the first record with it has it, and each of
            "records" its own.
        """
        names = dict.fromkeys(summary.name for summary in self.channels)
        return {
            **self._judgement(),
            "channels": {name: self.channel(name).to_dict() for name in names},
            "alerts": [alert.to_dict() for alert in self.alerts],
            "records": [
                {
                    "record": label,
                    "samples": len(record),
                    "rate": record.rate,
                    "start": record.start,
                    "notes": list(record.notes),
                    "channels": {summary.name: summary.to_dict() for summary in self.channels_of(number)},
                }
                for number, (label, record) in enumerate(zip(labels(self.records), self.records, strict=True))
            ],
            **({} if self.levels is None else {"levels": self.levels.to_dict()}),
        }


def labels(records: tuple[Record, ...]) -> tuple[str, ...]:
    """A name for each record: its source, or its number where it has none or shares it."""
    sources = [record.source for record in records]
    return tuple(
        source if source and sources.count(source) == 1 else f"record {number}"
        for number, source in enumerate(sources, start=1)
    )
