"""Rows of a study as a Parquet file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pyarrow
from pyarrow import parquet


def write(records: list[dict[str, Any]], path: Path) -> None:
    """One column a key, at least one record."""
    parquet.write_table(pyarrow.Table.from_pylist(records), path)
