"""Measured frequency response functions as the record of a pulse, whose spectrum is 1 N at every line that was measured."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from linkwise.arrays import Floats
from linkwise.errors import RecordError
from linkwise.records.record import Record

_PER_PERIOD = 8  # samples of the highest frequency: splines through them follow the pulse
_BEFORE = 0.1  # of the period, before the pulse
_EVEN = 1e-4  # of the spacing of lines: what single precision leaves of it


def record_of_responses(frequencies: ArrayLike, responses: Mapping[str, ArrayLike], *, force: str) -> Record:
    """The record of one period of the steady motion under pulses, from frequency response functions of one force.

    It is read as any other record: by `modal.identify_host`, and by `identify` and `validate`. What a function says of
    a line, the record says, and nothing of others.

    Parameters
    ----------
    frequencies : array of shape (L,)
        Evenly spaced frequencies in Hz, multiples of their spacing.
    responses : mapping of str to complex array of shape (L,)
        By channel, such as ``"a:beam.tip"``, motion per force in SI units, with motion of exp(i w t).
    force : str
        The channel of the force, such as ``"force:beam.tip"``.

    Returns
    -------
    Record
        The force and the motions, at 8 times the highest frequency.

    Raises
    ------
    RecordError
        If frequencies are not evenly spaced multiples, or a response has not as many lines.

    Examples
    --------
    >>> import numpy as np
    >>> import linkwise as lw
    >>> hz = np.arange(1.0, 21.0, 0.5)
    >>> s = 2j * np.pi * hz
    >>> receptance = 1.0 / (s**2 + 2 * 0.01 * 40.0 * s + 40.0**2)
    >>> record = lw.files.record_of_responses(hz, {"x:arm.tip": receptance}, force="force:arm.tip")
    >>> record.channels, record.duration < 2.0
    (('force:arm.tip', 'x:arm.tip'), True)
    """
    hz = np.asarray(frequencies, dtype=np.float64)
    spacing = (hz[-1] - hz[0]) / (len(hz) - 1) if hz.ndim == 1 and len(hz) > 1 else 0.0
    lines = np.rint(hz / spacing).astype(int) if spacing > 0.0 else np.zeros(0, dtype=int)
    if not len(lines) or np.abs(hz - lines * spacing).max() > _EVEN * spacing * lines.max() or lines[0] < 0:
        raise RecordError(
            "frequencies of response functions must be evenly spaced multiples of their spacing"
        )
    count = _PER_PERIOD * int(lines[-1])
    at = np.exp(-2j * np.pi * lines * _BEFORE)

    def motion(name: str, values: ArrayLike) -> Floats:
        spectrum = np.zeros(count // 2 + 1, dtype=complex)
        measured = np.asarray(values)
        if measured.shape != hz.shape:
            raise RecordError(f"has {measured.size} lines, and there are {len(hz)} frequencies", channel=name)
        known = np.isfinite(measured) & (lines > 0)
        spectrum[lines[known]] = (measured * at)[known]
        return np.asarray(np.fft.irfft(spectrum, count) * 0.5 * count)

    columns = [motion(force, np.ones(len(hz))), *(motion(*entry) for entry in responses.items())]
    return Record(0.0, count * spacing, (force, *responses), np.column_stack(columns))
