"""Frequency response functions and coherence, by Welch's method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from linkwise.argument_types import checked
from linkwise.arrays import Floats
from linkwise.records.record import Record
from linkwise.signals.integrate import bridged

_BLOCKS = 8  # that fit into a record side by side
_EXCITED = 1e-4  # of the largest power density of the force: below it there is no information
_LEAST = 32  # samples of a block


@dataclass(frozen=True, eq=False)
class ResponseFunction:
    """The response of one channel to one force.

    Attributes
    ----------
    response, force : str
        The channels.
    frequency : array of shape (F,)
        Frequencies in Hz.
    magnitude : array of shape (F,)
        Absolute value of the response function, in units of the response per N (the estimate H1); NaN where the force has
        next to no power.
    coherence : array of shape (F,)
        The part of the power of the response that follows from the force linearly; NaN as well.

    Examples
    --------
    >>> import linkwise as lw
    >>> import numpy as np
    >>> force = np.random.default_rng(1).standard_normal(4000)
    >>> record = lw.Record.from_arrays(np.arange(4000) / 1000.0, {"force:m1": force, "a:m1": 2.0 * force})
    >>> found = lw.compare_levels([record, record], modes=1).responses[0]
    >>> round(float(np.median(found.magnitude)), 6), round(float(np.median(found.coherence)), 6)
    (2.0, 1.0)
    """

    response: str
    force: str
    frequency: Floats
    magnitude: Floats
    coherence: Floats

    @classmethod
    @checked
    def of(cls, record: Record, response: str, force: str) -> ResponseFunction:
        """Estimate that of two channels of a record; missing samples are bridged by straight lines.

        Parameters
        ----------
        record : Record
            The record.
        response, force : str
            The channels.

        Returns
        -------
        ResponseFunction
            The response function.
        """
        values, applied = bridged(record, response), record.channel(force)
        block = max(min(len(record), _LEAST), 2 * len(record) // (_BLOCKS + 1))
        options = {"fs": record.rate, "nperseg": block, "detrend": "constant"}
        frequency, cross = scipy.signal.csd(applied, values, **options)
        of_force, of_response = (scipy.signal.welch(signal, **options)[1] for signal in (applied, values))
        tiny = np.finfo(float).tiny
        magnitude = np.abs(cross) / np.maximum(of_force, tiny)
        coherence = np.abs(cross) ** 2 / np.maximum(of_force * of_response, tiny)
        unexcited = of_force < _EXCITED * of_force.max()
        magnitude[unexcited] = coherence[unexcited] = np.nan
        return cls(response, force, frequency[1:], magnitude[1:], coherence[1:])
