"""The checks of an inspection by name: a new one is a file and a line."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from linkwise.inspection.alert import Alert
from linkwise.inspection.at_rest import drift_at_rest, offset_at_rest
from linkwise.inspection.clipped import clipped
from linkwise.inspection.dead import dead
from linkwise.inspection.derivative_relation import delay, drift, gain, offset
from linkwise.inspection.doubled import doubled
from linkwise.inspection.dropped import dropped, lost
from linkwise.inspection.equal import equal
from linkwise.inspection.floor import aliasing, coloured
from linkwise.inspection.hum import hum
from linkwise.inspection.quantised import quantised
from linkwise.inspection.record_signals import RecordSignals
from linkwise.inspection.sampling import few_samples, short
from linkwise.inspection.spikes import spikes
from linkwise.inspection.unit import unit
from linkwise.registry import Registry

Check = Callable[[RecordSignals], Iterable[Alert]]

CHECKS: Registry[Check] = Registry(
    "check",
    {
        "dead": dead,
        "equal": equal,
        "unit": unit,
        "clipped": clipped,
        "dropped": dropped,
        "lost": lost,
        "doubled": doubled,
        "quantised": quantised,
        "spikes": spikes,
        "delay": delay,
        "gain": gain,
        "offset": offset,
        "offset at rest": offset_at_rest,
        "drift": drift,
        "drift at rest": drift_at_rest,
        "hum": hum,
        "aliasing": aliasing,
        "coloured": coloured,
        "few-samples": few_samples,
        "short": short,
    },
)
"""Functions of the signals of a record that give alerts."""
