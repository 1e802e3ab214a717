"""MATLAB files of versions 4 to 7. Their structure is checked before SciPy reads them, which crashes where it is damaged.

After a header of 128 bytes, a file of version 5 to 7 is a sequence of elements, each a tag of its type and its number of
bytes, and these bytes; matrices hold elements in turn (MathWorks, "MAT-File Format", chapter 1). Files of version 4 have no
such header, and SciPy reads them in Python.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from io import BytesIO
from math import prod
from pathlib import Path
from typing import Any

import numpy as np
import scipy
from scipy.sparse import csc_array

_HEADER = 128  # bytes; the last four are the version and a mark of the byte order
_BYTE_ORDERS = {b"IM": "<", b"MI": ">"}
_UNSIGNED, _MATRIX, _COMPRESSED = 6, 14, 15  # types of elements
# types of elements, those of texts among them
_NUMBERS = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 16, 17, 18})
# classes
_CELLS, _STRUCT, _OBJECT, _TEXT, _SPARSE, _NUMERIC, _FUNCTION, _OPAQUE = (1, 2, 3, 4, 5, range(6, 16), 16, 17)
_ELEMENTS = {
    _CELLS: 3,
    _STRUCT: 5,
    _OBJECT: 6,
    _TEXT: 4,
    _SPARSE: 6,
    _FUNCTION: 3,
    _OPAQUE: 4,
} | dict.fromkeys(_NUMERIC, 4)
"""Elements of numbers and texts in a matrix by its class: flags, dimensions, name and what follows; one more if complex."""
_COMPLEX = 0x800  # in the flags
_DEEPEST = 50  # matrices within matrices


def load_mat(path: Path, **options: Any) -> dict[str, Any]:
    """The variables of a file by name, as `scipy.io.loadmat` gives them with the same options.

    Raises ValueError for a file that is cut or damaged, and whatever SciPy raises besides. Sparse matrices are as the file
    states them, see `sound_sparse`.
    """
    content = path.read_bytes()
    # version 5, as SciPy tells it from 4 and 7.3
    if 0 not in content[:4] and 1 in content[_HEADER - 4 : _HEADER - 2]:
        content = _sound(content)
    variables = scipy.io.loadmat(BytesIO(content), spmatrix=False, **options)
    return {name: value for name, value in variables.items() if not name.startswith("__")}


def sound_sparse(matrix: Any) -> csc_array:
    """A sparse matrix of a file; ValueError where its indices lie outside it, which SciPy follows into other memory."""
    matrix = csc_array(matrix)
    if (np.diff(matrix.indptr) < 0).any():  # unseen by SciPy where the last is 0
        raise ValueError("the columns of a sparse matrix are out of order")
    matrix.check_format()
    return matrix


def _sound(content: bytes) -> bytes:
    """The content of a file of version 5 with its variables inflated; ValueError unless each is whole."""
    order = _BYTE_ORDERS.get(content[_HEADER - 2 : _HEADER])
    if order is None:
        raise ValueError("its header is damaged; copy or save the file again")
    view, position = memoryview(content), _HEADER
    inflated: list[bytes | memoryview] = [view[:position]]
    while position + 8 <= len(content):
        kind, length = struct.unpack_from(f"{order}II", content, position)
        start, end = position + 8, position + 8 + length
        if end > len(content):
            raise ValueError(
                f"the variable that begins at byte {position} states a length of {length} bytes, more than the "
                f"{len(content) - start} that follow; the file is cut or damaged, so copy or save it again"
            )
        try:
            element = zlib.decompress(view[start:end]) if kind == _COMPRESSED else view[position:end]
            kind, length = struct.unpack_from(f"{order}II", element)
            if kind != _MATRIX or length != len(element) - 8:
                message = f"it is of type {kind} and of {length} bytes, not a matrix of {len(element) - 8}"
                raise ValueError(message)
            _check_matrix(memoryview(element)[8:], order)
        except (ValueError, struct.error, zlib.error) as error:
            message = f"the variable that begins at byte {position} is damaged ({error}); copy or save the file again"
            raise ValueError(message) from error
        inflated.append(element)
        position = end
    return b"".join([*inflated, view[position:]])


def _check_matrix(content: memoryview, order: str, depth: int = 0) -> None:
    """Raise ValueError unless a matrix holds just the elements that its class and dimensions ask for."""
    if depth and not content:
        return  # an empty one
    elements = list(_elements(content, order))
    lists = [data for kind, data in elements if kind != _MATRIX]
    matrices = [data for kind, data in elements if kind == _MATRIX]
    if not lists or elements[0][0] != _UNSIGNED or len(lists[0]) != 8:
        raise ValueError("a matrix has no flags")
    flags = struct.unpack_from(f"{order}I", lists[0])[0]
    mclass = flags & 0xFF
    parts = 1 if flags & _COMPLEX and (mclass == _SPARSE or mclass in _NUMERIC) else 0
    if len(lists) != _ELEMENTS.get(mclass, -1) + parts:
        raise ValueError(f"a matrix of class {mclass} has {len(lists)} elements")
    dimensions = (1,) if mclass == _OPAQUE else _integers(lists[1], order)
    size = prod(dimensions)
    if min(dimensions, default=-1) < 0 or (mclass != _SPARSE and size > len(content)):
        raise ValueError(f"a matrix states dimensions of {' x '.join(map(str, dimensions))}")
    within = size if mclass in (_CELLS, _STRUCT, _OBJECT) else int(mclass in (_FUNCTION, _OPAQUE))
    if mclass in (_STRUCT, _OBJECT):
        width = _integers(lists[-2], order)
        if len(width) != 1 or width[0] < 1:
            raise ValueError("a struct states no width of its names")
        within *= len(lists[-1]) // width[0]
    if len(matrices) != within:
        raise ValueError(f"a matrix of class {mclass} holds {len(matrices)} others, not {within}")
    if depth == _DEEPEST or any(len(matrix) % 8 for matrix in matrices):
        raise ValueError("matrices within matrices do not end where they state")
    for matrix in matrices:
        _check_matrix(matrix, order, depth + 1)


def _integers(data: memoryview, order: str) -> tuple[int, ...]:
    return struct.unpack(f"{order}{len(data) // 4}i", data)


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Type and bytes of every element of a matrix; ValueError for one of unknown type or that runs past the end."""
    position = 0
    while position < len(content):
        kind, length = struct.unpack_from(f"{order}II", content, position)
        position += 8
        room = length if kind == _MATRIX else -(-length // 8) * 8
        if kind >> 16:  # up to four bytes that stand in the tag
            position, kind, length, room = position - 4, kind & 0xFFFF, kind >> 16, 4
        if length > room or position + length > len(content):
            raise ValueError(f"an element of {length} bytes runs past its end")
        if kind not in _NUMBERS and kind != _MATRIX:
            raise ValueError(f"an element is of the unknown type {kind}")
        yield kind, content[position : position + length]
        position += room
