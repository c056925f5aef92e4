"""Zip archives: list of the members from the central directory, and reading of one by its byte range."""

from __future__ import annotations

import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import IO

from beltscape.core.errors import InputError
from beltscape.reprocessing.recordings.archives.member import Member
from beltscape.reprocessing.recordings.storage import LARGEST_BYTES

_HEADER = struct.Struct("<4sHHHHHIIIHH")
"""Local file header: signature, version, flags, method, time, date, CRC, two sizes, two lengths (APPNOTE 4.3.7)."""
_CRC = struct.Struct("<I")
_SIGNATURE, _DESCRIPTOR_SIGNATURE = b"PK\x03\x04", b"PK\x07\x08"
_ENCRYPTED, _DESCRIPTOR = 0x1, 0x8
"""Flags: the data is encrypted; the CRC follows the data (APPNOTE 4.4.4)."""
_MARGIN = 1 << 10
"""Bytes read beside the packed data: header, name and CRC; a longer name or extra field costs a second reading."""
_DESCRIPTOR_BYTES = 8
"""Bytes of a data descriptor up to its CRC: the signature, which may be missing, and the CRC (APPNOTE 4.3.9)."""


def list_zip(file: IO[bytes], url: str) -> dict[str, Member]:
    """Return the files of a zip archive by name; InputError if it is damaged, encrypted or packed otherwise."""
    try:
        with zipfile.ZipFile(file) as archive:
            infos = [info for info in archive.infolist() if not info.is_dir()]
    except (zipfile.BadZipFile, NotImplementedError, ValueError, struct.error, EOFError) as error:
        raise InputError(f"{url}: the archive is damaged or cut short ({error}); copy it again") from error
    for info in infos:
        if info.flag_bits & _ENCRYPTED:
            raise InputError(f"{url}: the archive is encrypted; pack it without a password")
        if info.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
            raise InputError(
                f"{url}: {info.filename} is packed by method {info.compress_type}; pack it again by deflate or store"
            )
    return {
        info.filename: Member(info.header_offset, info.compress_size, info.file_size, f"{info.CRC:08x}")
        for info in infos
    }


def read_zip_member(read: Callable[[int, int], bytes], start: int, length: int, name: str) -> bytes:
    """Return the unpacked bytes of the member whose local header is at ``start``.

    ``read`` returns the archive's bytes of a range; ``length`` is that of the packed data.

    Raises
    ------
    InputError
        When the header is none, the data does not unpack, or the checksum differs.
    """
    data = read(start, start + length + _MARGIN)
    try:
        signature, _, flags, method, _, _, crc, _, _, name_bytes, extra_bytes = _HEADER.unpack_from(data)
        begin = _HEADER.size + name_bytes + extra_bytes
        end = begin + length
        if len(data) < end + _DESCRIPTOR_BYTES:
            data = read(start, start + end + _DESCRIPTOR_BYTES)
        if flags & _DESCRIPTOR:
            signed = data[end : end + len(_DESCRIPTOR_SIGNATURE)] == _DESCRIPTOR_SIGNATURE
            (crc,) = _CRC.unpack_from(data, end + (len(_DESCRIPTOR_SIGNATURE) if signed else 0))
        unpacked = _unpack(data[begin:end], method)
    except (struct.error, zlib.error) as error:
        raise _damage(name, str(error)) from error
    if signature != _SIGNATURE or len(data) < end:
        raise _damage(name, "the archive has changed or is cut short")
    if zlib.crc32(unpacked) != crc:
        raise _damage(name, "wrong checksum")
    return unpacked


def _unpack(packed: bytes, method: int) -> bytes:
    if method == zipfile.ZIP_STORED:
        return packed
    inflater = zlib.decompressobj(-zlib.MAX_WBITS)
    unpacked = inflater.decompress(packed, LARGEST_BYTES)
    if not inflater.eof:
        raise zlib.error(f"cut short, or larger than {LARGEST_BYTES >> 20} MiB")
    return unpacked


def _damage(name: str, reason: str) -> InputError:
    return InputError(f"{name}: the file is damaged in its archive ({reason}); copy the archive again")
