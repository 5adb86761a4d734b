"""Checks what a MATLAB file declares before it is unpacked: compressed elements, and sizes larger than the bytes that
follow.

The MAT-File format, version 5 (MathWorks 2019): an element is a tag, with type and number of bytes, and nested
elements.
"""

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from math import prod
from pathlib import Path

from estlab.datasets.data_files import check_size
from estlab.errors import UserError

_HEADER = 128
_COMPRESSED, _MATRIX = 15, 14
_CELL, _STRUCT, _OBJECT, _CHAR = 1, 2, 3, 4
_NUMBERS = range(6, 16)
_OF_AN_ELEMENT = 200  # minimum bytes of memory for a value of a cell or field
_DEEPEST = 32


def check_declared(path: Path, content: bytes) -> None:
    """Raise UserError that names the file if reading it would take far more memory than its size justifies.

    Files of other versions pass: they are not compressed.
    """
    if len(content) < _HEADER or content[126:128] not in (b"IM", b"MI"):
        return
    order = "<" if content[126:128] == b"IM" else ">"
    limits = _Limits(path, order)
    at = _HEADER
    while at + 8 <= len(content):
        kind, size = struct.unpack_from(f"{order}II", content, at)
        body = memoryview(content)[at : at + 8 + size]
        if kind == _COMPRESSED:
            body = memoryview(limits.unpacked(content[at + 8 : at + 8 + size]))
        limits.take(body)
        at += 8 + size


@dataclass
class _Limits:
    path: Path
    order: str
    taken: int = 0

    def unpacked(self, packed: bytes) -> bytes:
        """One compressed element, if its size is plausible."""
        try:
            head = zlib.decompressobj().decompress(packed, 8)
            size = struct.unpack(f"{self.order}II", head)[1]
            self._add(size)
            return zlib.decompressobj().decompress(packed, size + 8)
        except (zlib.error, struct.error):
            return b""  # damaged, which its reader will report

    def take(self, body: memoryview, depth: int = 0) -> None:
        """Check one element and those nested in it."""
        for kind, data in self._elements(body):
            if kind == _MATRIX and len(data):
                self._take_matrix(data, depth)

    def _take_matrix(self, data: memoryview, depth: int) -> None:
        parts = self._elements(data)
        flags, shape, _name = (next(parts, (0, memoryview(b"")))[1] for _ in range(3))
        if depth > _DEEPEST:
            raise UserError(f"{self.path}: cells nested {depth} deep; not a recording")
        if len(flags) < 4 or len(shape) % 4:
            return
        group = struct.unpack_from(f"{self.order}I", flags)[0] & 0xFF
        count = prod(abs(n) for n in struct.unpack(f"{self.order}{len(shape) // 4}i", shape))
        if group in (_STRUCT, _OBJECT):
            widths = [next(parts, (0, memoryview(b"")))[1] for _ in range(2 + (group == _OBJECT))]
            width = struct.unpack(f"{self.order}i", widths[-2][:4])[0] if len(widths[-2]) >= 4 else 1
            count *= max(1, len(widths[-1]) // max(1, width))
        if group in (_CELL, _STRUCT, _OBJECT):
            self._hold(8 * count, len(data))
            self._add(_OF_AN_ELEMENT * count)
            for kind, inner in parts:
                if kind == _MATRIX and len(inner):
                    self._take_matrix(inner, depth + 1)
        elif group in _NUMBERS or group == _CHAR:
            self._hold(count, len(data))
            self._add(8 * count)

    def _elements(self, data: memoryview) -> Iterator[tuple[int, memoryview]]:
        at = 0
        while at + 8 <= len(data):
            kind, size = struct.unpack_from(f"{self.order}II", data, at)
            if kind >> 16:  # a small element: size and kind in one word, four bytes of data in the other
                yield kind & 0xFFFF, data[at + 4 : at + 4 + min(4, kind >> 16)]
                at += 8
            else:
                yield kind, data[at + 8 : at + 8 + size]
                at += 8 + size + -size % 8

    def _hold(self, needed: int, there: int) -> None:
        if needed > there:
            raise UserError(f"{self.path}: declares an array of {needed} bytes, but only {there} follow")

    def _add(self, size: int) -> None:
        self.taken += size
        check_size(self.path, self.taken, "unpacked, ")
