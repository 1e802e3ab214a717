"""Alerts: one thing that is wrong with a channel, what it does to an answer and what mends it."""

from __future__ import annotations

from dataclasses import dataclass


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
    >>> lw.Alert("dead", "x:m1", "every sample is 0; leave the channel out", float("inf")).kind
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
