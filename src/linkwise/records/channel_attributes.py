"""What a record states of its channels beside their samples: fields of `Record` that are mappings by channel."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from linkwise.records.interpolation import BAND_LIMITED


@dataclass(frozen=True)
class ChannelAttribute:
    """An attribute of channels, under the name of its field in `Record`.

    `label` is what messages call it. `stored` is the type that files store it as, a mapping by channel of numbers or texts;
    None for one that formats write in a way of their own. `absent` stands for no value in formats that hold one for every
    channel. One `of_samples` belongs to those of a record, not to its sensors.
    """

    label: str
    stored: Any = None
    absent: float | str = ""
    of_samples: bool = False

    @property
    def is_text(self) -> bool:
        """Whether its values are texts, not numbers."""
        return isinstance(self.absent, str)

    def is_absent(self, value: float | str) -> bool:
        """Whether a value is `absent`, or NaN."""
        return value == self.absent or (isinstance(value, float) and math.isnan(value))


OF_CHANNELS = {
    "noise": ChannelAttribute("noise", stored=dict[str, float], absent=math.nan),
    "interpolation": ChannelAttribute("interpolation", stored=dict[str, str], absent=BAND_LIMITED),
    "units": ChannelAttribute("unit"),  # of a column, which holds it in its header
    "uncertainty": ChannelAttribute("uncertainty"),  # see files/sensor_attributes.py
    "clipped": ChannelAttribute("clipped samples", of_samples=True),
}
STORED = {name: attribute for name, attribute in OF_CHANNELS.items() if attribute.stored is not None}
"""Those that the formats of files store without knowing them."""
