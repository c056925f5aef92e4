"""Random access to a gzip stream: unpacking goes on from copies of the inflater's state that were kept on the way."""

from __future__ import annotations

import zlib
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Callable
from threading import Lock
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from zlib import _Decompress as Inflater  # pyright: ignore[reportPrivateUsage]  # its class has no public name

_GZIP = zlib.MAX_WBITS | 16
"""Window bits of a gzip stream with its header and checksum (zlib's manual, inflateInit2)."""
_BLOCK = 1 << 20
"""Packed bytes that are read at once."""
_BLOCKS = 16
"""Blocks kept: readers of several cameras unpack at as many places of the archive."""
_SLICE = 1 << 16
"""Packed bytes that are fed to the inflater at once: a kept state holds what is left of one slice."""
_SKIP = 1 << 20
"""Unpacked bytes that are made at once where they are only skipped."""
_CHECKPOINTS = 1000
"""Kept states of the whole stream, each about 50 kB: at most 1 / 1000 of it is unpacked again for a jump back."""
_CURSORS = 16
"""States kept behind the last reads: files that follow one another are unpacked once."""


class GzipStream:
    """Reads any range of what a gzip file holds; usable from several threads."""

    def __init__(self, read: Callable[[int, int], bytes], packed_bytes: int) -> None:
        """``read`` returns the packed bytes of a range."""
        self._read, self._packed_bytes = read, packed_bytes
        self._spacing = max(_BLOCK, packed_bytes // _CHECKPOINTS)
        self._checkpoints = [_Cursor(zlib.decompressobj(_GZIP), b"", 0, 0)]
        self._recent: OrderedDict[int, _Cursor] = OrderedDict()
        self._blocks: OrderedDict[int, bytes] = OrderedDict()
        self._lock = Lock()

    def read(self, start: int, end: int) -> bytes:
        """Return the unpacked bytes of a range; shorter at the end of the stream.

        Raises
        ------
        zlib.error
            When the packed bytes are damaged.
        EOFError
            When the stream is cut short.
        """
        with self._lock:
            cursor = self._take_cursor(start)
            while cursor.position < start and self._inflate(cursor, min(start - cursor.position, _SKIP)):
                pass
            parts: list[bytes] = []
            while cursor.position < end and (part := self._inflate(cursor, end - cursor.position)):
                parts.append(part)
            self._recent[cursor.position] = cursor
            while len(self._recent) > _CURSORS:
                self._recent.popitem(last=False)
            return b"".join(parts)

    def _take_cursor(self, start: int) -> _Cursor:
        """Return the state that is nearest before ``start``, for the caller alone."""
        recent = max((position for position in self._recent if position <= start), default=-1)
        index = bisect_right(self._checkpoints, start, key=lambda cursor: cursor.position) - 1
        if recent >= self._checkpoints[index].position:
            return self._recent.pop(recent)
        return self._checkpoints[index].copy()

    def _inflate(self, cursor: _Cursor, most: int) -> bytes:
        """Return at least one of the next ``most`` unpacked bytes; empty at the end of the stream."""
        while True:
            if cursor.inflater.eof and not self._begin_next_stream(cursor):
                return b""
            if not cursor.pending and not self._feed(cursor):
                raise EOFError("the compressed stream is cut short")
            part = cursor.inflater.decompress(cursor.pending, most)
            cursor.pending = cursor.inflater.unconsumed_tail
            cursor.position += len(part)
            self._keep_checkpoint(cursor)
            if part:
                return part

    def _begin_next_stream(self, cursor: _Cursor) -> bool:
        """Begin the stream that follows a finished one, as in joined files; return False without one."""
        rest = cursor.inflater.unused_data.lstrip(b"\0")
        while not rest:
            if not self._feed(cursor):
                return False
            rest = cursor.pending.lstrip(b"\0")
        cursor.inflater, cursor.pending = zlib.decompressobj(_GZIP), rest
        return True

    def _feed(self, cursor: _Cursor) -> bool:
        """Take the next slice of packed bytes; False where there is none."""
        block, offset = divmod(cursor.packed, _BLOCK)
        cursor.pending = self._read_block(block)[offset : offset + _SLICE]
        cursor.packed += len(cursor.pending)
        return bool(cursor.pending)

    def _read_block(self, block: int) -> bytes:
        if block not in self._blocks:
            start = block * _BLOCK
            self._blocks[block] = self._read(start, start + _BLOCK) if start < self._packed_bytes else b""
        self._blocks.move_to_end(block)
        while len(self._blocks) > _BLOCKS:
            self._blocks.popitem(last=False)
        return self._blocks[block]

    def _keep_checkpoint(self, cursor: _Cursor) -> None:
        far = cursor.position >= self._checkpoints[-1].position + self._spacing
        if far and not cursor.pending and not cursor.inflater.eof:
            self._checkpoints.append(cursor.copy())


class _Cursor:
    """State of unpacking at one position."""

    __slots__ = ("inflater", "packed", "pending", "position")

    def __init__(self, inflater: Inflater, pending: bytes, packed: int, position: int) -> None:
        self.inflater = inflater
        self.pending = pending
        """Packed bytes that were read and not unpacked yet."""
        self.packed = packed
        """Packed bytes read so far."""
        self.position = position
        """Unpacked bytes so far."""

    def copy(self) -> _Cursor:
        """Return an independent copy."""
        return _Cursor(self.inflater.copy(), self.pending, self.packed, self.position)
