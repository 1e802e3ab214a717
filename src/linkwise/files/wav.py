"""WAV: one column per track, by number, at the rate that the file states; it states no unit."""

from __future__ import annotations

from pathlib import Path

from scipy.io import wavfile

from linkwise.files.table import Column, Table


def read_table(path: Path) -> Table:
    """All tracks of the file; integers are parts of full scale, from -1 to 1."""
    rate, values = wavfile.read(path)
    tracks = values.reshape(len(values), -1).astype(float)
    if values.dtype.kind in "iu":
        middle = 128.0 if values.dtype.kind == "u" else 0.0
        tracks = (tracks - middle) / 2.0 ** (8 * values.itemsize - 1)
    columns = tuple(Column(str(number), track) for number, track in enumerate(tracks.T, start=1))
    return Table(columns, named=False, opening="RIFF", rate=float(rate))
