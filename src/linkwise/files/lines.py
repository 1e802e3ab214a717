"""The lines of a text file in any common encoding."""

from __future__ import annotations

import codecs
from pathlib import Path

from linkwise.errors import RecordError

_BYTE_ORDER_MARKS = (  # the longer first: that of UTF-32 begins with that of UTF-16
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
_PROBE = 4096  # bytes from which the encoding is inferred


def read_lines(path: Path) -> list[str]:
    """The lines of a text file without line ends (LF, CRLF or CR).

    A byte order mark decides the encoding. Without one it is UTF-16 where every other byte is zero, else UTF-8 if the content
    is valid, else Windows 1252, in which older instruments write µ and ². Raises RecordError for a binary file.
    """
    content = path.read_bytes()
    try:
        text = content.decode(_encoding(content, path))
    except UnicodeDecodeError as error:
        line = error.object.count(b"\n", 0, error.start) + 1
        raise RecordError(f"is not valid {error.encoding} text; save it as UTF-8", path, line) from error
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    while lines and not lines[-1].strip():
        lines.pop()
    if not lines:
        raise RecordError("the file contains only blank lines", path)
    return lines


def _encoding(content: bytes, path: Path) -> str:
    for mark, encoding in _BYTE_ORDER_MARKS:
        if content.startswith(mark):
            return encoding
    head = content[:_PROBE]
    if b"\0" in head:
        if head[1::2].count(0) > 0.8 * len(head[1::2]) and not head[::2].count(0):
            return "utf-16-le"
        if head[::2].count(0) > 0.8 * len(head[::2]) and not head[1::2].count(0):
            return "utf-16-be"
        raise RecordError("is a binary file, not text; its suffix may be wrong", path)
    try:
        content.decode("utf-8")
    except UnicodeDecodeError:
        return "cp1252"
    return "utf-8"
