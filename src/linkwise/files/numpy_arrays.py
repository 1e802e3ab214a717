"""NumPy files: `.npy`, one array, and `.npz`, several by name. Nothing in them is unpickled.

Names are those of channels, or as MATLAB spells them (`x_m1` for x:m1); `fs` or `rate` is the sampling rate, `dt` the step;
`sensors`, a JSON text, is what is known of sensors by channel. A channel of a periodic test may be an array of periods by
samples, or of realisations by periods by samples.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from linkwise.errors import RecordError
from linkwise.files.arrays import columns_of, spelled_as_channel, stated_rate
from linkwise.files.periods import with_joined_periods
from linkwise.files.sensor_attributes import as_statements
from linkwise.files.table import Column, Table


def read_table(path: Path) -> Table:
    """The columns of an array or of several; see `files.read_record`."""
    content = np.load(path, allow_pickle=False)
    if not isinstance(content, np.ndarray):
        with content:
            arrays = {name: content[name] for name in content.files}
        arrays, notes = with_joined_periods(arrays)
        columns = tuple(spelled_as_channel(column) for column in columns_of(arrays))
        sensors = as_statements(arrays.get("sensors"), path)
        return Table(columns, rate=stated_rate(arrays), notes=notes, sensors=sensors)
    if content.dtype.names:
        named = {name: content[name] for name in content.dtype.names}
        return Table(tuple(spelled_as_channel(column) for column in columns_of(named)))
    array = np.squeeze(content)
    if array.ndim not in (1, 2) or not array.size:
        raise RecordError(
            f"holds an array of {' x '.join(map(str, content.shape))} numbers: expected one of samples by channels",
            path,
        )
    upright = np.atleast_2d(array.T).T if array.ndim == 1 else max(array, array.T, key=len)
    columns = tuple(Column.of(str(i + 1), upright[:, i]) for i in range(upright.shape[1]))
    return Table(columns, named=False, opening=" ".join(map(str, upright[0])))
