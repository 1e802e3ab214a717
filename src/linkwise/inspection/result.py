"""The result of an inspection: its channels and alerts, each of which says what it does to an answer and what mends it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from linkwise.display import JudgedView, align_columns, remark_lines
from linkwise.errors import RecordError
from linkwise.records.joining import labels
from linkwise.records.record import Record
from linkwise.verdict import Verdict

if TYPE_CHECKING:  # what it is made of loads where levels are compared
    from linkwise.inspection.level_comparison import LevelComparison


@dataclass(frozen=True)
class Alert:
    """Something that is wrong with a channel.

    Attributes
    ----------
    kind : str
        ``"clipped"``, ``"quantised"``, ``"dropped"``, ``"doubled"``, ``"spikes"``, ``"offset"``, ``"drift"``, ``"hum"``,
        ``"dead"``, ``"equal"``, ``"delay"``, ``"gain"``, ``"aliasing"``, ``"coloured"``, ``"few-samples"``, ``"short"`` or
        ``"unit"``.
    channel : str
        Name of the channel.
    message : str
        What was seen, what it does to an answer, and what mends it.
    error : float
        Estimated root mean square of what is wrong, relative to that of the channel; infinite where the channel is useless.
    record : str
        The record, by its source.
    arguments : tuple of str
        Arguments of `read_record`, `identify`, `Record` or `Record.between` by which it is mended.
    frequencies : tuple of float
        Frequencies in Hz of the lines of a hum.
    is_of_gaps : bool
        Whether it says no more than that samples are missing.

    Examples
    --------
    >>> import linkwise as lw
    >>> lw.inspection.Alert("dead", "x:m1", "every sample is 0; leave the channel out", float("inf")).kind
    'dead'
    """

    kind: str
    channel: str
    message: str
    error: float
    record: str = ""
    arguments: tuple[str, ...] = ()
    frequencies: tuple[float, ...] = ()
    is_of_gaps: bool = False

    def __str__(self) -> str:
        return f"{self.kind} {self.channel}: {self.message}"

    def to_dict(self) -> dict[str, str]:
        """What the JSON of an inspection holds of it.

        Returns
        -------
        dict of str to str
            Its part of the JSON of an inspection.
        """
        return {"kind": self.kind, "channel": self.channel, "message": self.message, "record": self.record}


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
        compared = [] if self.levels is None else [str(self.levels), ""]
        alerts = (remark_lines(alert_text(self, alert)) for alert in self.alerts)
        return "\n".join([*compared, headline(self), *alerts, *_tables(self)])

    def __repr__(self) -> str:
        kinds = ", ".join(dict.fromkeys(alert.kind for alert in self.alerts)) or "no alerts"
        records = "1 record" if len(self.records) == 1 else f"{len(self.records)} records"
        return f"Inspection of {records}, {len(self.channels)} channels: {kinds}"

    @property
    def verdicts(self) -> tuple[Verdict, ...]:
        """Whether something is wrong with a channel, and the verdict on levels if these were compared."""
        channels = Verdict.CHANNELS_IN_DOUBT if self.alerts else Verdict.NOTHING_WRONG_SEEN
        return (channels, *(() if self.levels is None else self.levels.verdicts))

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
            "method": "inspect",
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


HEAD = (
    "channel", "samples", "missing", "minimum", "maximum", "rms", "noise", "SNR dB", "bits", "up to Hz", "per period", "unit",
)  # fmt: skip


def headline(inspection: Inspection) -> str:
    """How much is wrong, in one sentence."""
    count = len(inspection.alerts)
    if not count:
        return "Nothing wrong was seen."
    return f"{count} alert{'s' if count > 1 else ''}, worst first."


def alert_text(inspection: Inspection, alert: Alert) -> str:
    """An alert in one line, with the record where there are several."""
    return f"{alert.record}: {alert}" if len(inspection.records) > 1 else str(alert)


def channel_row(channel: ChannelSummary) -> tuple[str, ...]:
    """The cells of a channel below `HEAD`."""
    return (
        channel.name,
        str(channel.samples),
        str(channel.missing) if channel.missing else "",
        *(_number(value) for value in (channel.minimum, channel.maximum, channel.rms, channel.noise)),
        "" if channel.snr_db is None else f"{channel.snr_db:.1f}",
        "" if channel.bits is None else f"{channel.bits:.1f}",
        _number(channel.highest_frequency),
        "" if channel.samples_per_period is None else f"{channel.samples_per_period:.3g}",
        channel.unit,
    )


def _tables(inspection: Inspection) -> list[str]:
    lines: list[str] = []
    for label, record in zip(labels(inspection.records), inspection.records, strict=True):
        end = record.start + record.duration
        span = f"{len(record)} samples at {record.rate:g} Hz, {record.start:g} to {end:g} s"
        rows = [channel_row(summary) for summary in inspection.channels if summary.record == label]
        lines += ["", f"{label}: {span}", *align_columns([HEAD, *rows])]
    return lines


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3g}"
