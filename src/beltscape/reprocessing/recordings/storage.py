"""Access to local folders and object stores through fsspec, with timeouts and errors in one line."""

from __future__ import annotations

import errno
import os
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISDIR, S_ISREG
from typing import IO, TYPE_CHECKING, Any

from beltscape.core.errors import InputError, describe_missing_library

if TYPE_CHECKING:
    from fsspec import AbstractFileSystem

LARGEST_BYTES = 1 << 30
"""Bytes of the largest file that is read: an image of 170 megapixels in colour of 16 bit; larger ones are refused."""

_S3_CONFIG = {
    "connect_timeout": 5,
    "read_timeout": 10,
    "retries": {"total_max_attempts": 2, "mode": "standard"},
}
"""Limits of botocore's client, s and tries: with s3fs's five tries a silent store fails in 100 s (default: 375 s)."""
_SERVER_AWAY = ("ESTALE", "ENOTCONN", "EHOSTDOWN", "ETIMEDOUT", "EREMOTEIO")
"""Errors of network file systems whose server is away (errno(3), nfs(5)); not every system has all."""


class UnreachableError(InputError):
    """A place as a whole does not answer: what was asked of it may be there."""


def is_local(url: str) -> bool:
    """Return whether an address is a path of this machine's file system."""
    return "://" not in url


def normalise_address(source: str) -> str:
    """Return a path as an absolute one, an address without a slash at its end."""
    source = source.removeprefix("file://")
    if is_local(source):
        return Path(os.path.abspath(os.path.expanduser(source))).as_posix()  # noqa: PTH100, PTH111  keeps links
    return source.rstrip("/") if not source.endswith("://") else source


def follow_link(entry: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the listing of what a symbolic link of this machine leads to; its type is empty without it."""
    try:
        target = os.stat(entry["name"])  # noqa: PTH116
    except OSError:
        return {"type": ""}
    kind = "directory" if S_ISDIR(target.st_mode) else "file" if S_ISREG(target.st_mode) else ""
    return {"type": kind, "size": target.st_size, "mtime": target.st_mtime}


def resolve_links(path: str) -> str:
    """Return a path of this machine without symbolic links."""
    return os.path.realpath(path)


def join_address(folder: str, path: str) -> str:
    """Return the address of a path below a folder."""
    if not path or folder.endswith("/"):
        return folder + path
    return f"{folder}/{path}"


def open_storage(url: str) -> tuple[AbstractFileSystem, str]:
    """Return the file system of an address and the path in it; fsspec keeps one file system per process."""
    from fsspec import filesystem
    from fsspec.core import url_to_fs

    if is_local(url):
        return filesystem("file"), url
    return url_to_fs(url, **_choose_options(url))


def read_bytes(url: str, start: int | None = None, end: int | None = None) -> bytes:
    """Return the bytes of a file from ``start`` to before ``end``, all by default.

    Raises
    ------
    InputError
        When the file is missing, locked or too large.
    UnreachableError
        When its store does not answer, or its file system is away.
    """
    with named_faults(url):
        file_system, path = open_storage(url)
        if start is None and is_local(url) and os.stat(path).st_size > LARGEST_BYTES:  # noqa: PTH116
            raise InputError(f"{url}: larger than {LARGEST_BYTES >> 20} MiB; no image or table is so large")
        return file_system.cat_file(path, start=start, end=end)


def measure_size(url: str) -> int:
    """Return the bytes of a file; errors as `read_bytes`."""
    with named_faults(url):
        file_system, path = open_storage(url)
        return int(file_system.size(path) or 0)


@contextmanager
def open_file(url: str) -> Generator[IO[bytes]]:
    """Open a file for reading at any position; errors of the ``with`` block are named as in `read_bytes`."""
    with named_faults(url):
        file_system, path = open_storage(url)
        with file_system.open(path, "rb") as file:
            yield file


@contextmanager
def named_faults(url: str) -> Generator[None]:
    """Turn the errors of fsspec's file systems, which have no class in common, into InputError in one line."""
    try:
        yield
    except InputError:
        raise
    except ImportError as error:
        missing = describe_missing_library(error) or _describe_missing_protocol(url, error)
        raise InputError(f"{url}: {missing}") from error
    except (FileNotFoundError, NotADirectoryError) as error:
        if error.strerror is None:
            raise InputError(f"{url}: no such file, folder or bucket; check the address") from error
        raise InputError(f"{url}: cannot be read ({error.strerror})") from error
    except PermissionError as error:
        fix = "give read permission" if is_local(url) else "check the keys (AWS_*, fsspec's configuration)"
        raise InputError(f"{url}: cannot be read ({_describe(error)}); {fix}") from error
    except Exception as error:
        code = errno.errorcode.get(getattr(error, "errno", None) or 0)
        if isinstance(error, ValueError) or (is_local(url) and code not in _SERVER_AWAY):
            raise InputError(f"{url}: cannot be read ({_describe(error)})") from error
        raise UnreachableError(
            f"{url}: does not answer ({_describe(error)}); check address, network and keys, and run it again"
        ) from error


def _choose_options(url: str) -> Mapping[str, Any]:
    """Return the options of an address's file system; those of fsspec's configuration have priority."""
    protocol = url.partition("://")[0]
    if protocol not in ("s3", "s3a"):
        return {}
    from fsspec.config import conf

    own = conf.get(protocol, {}).get("config_kwargs", {})
    return {"config_kwargs": {**_S3_CONFIG, **own}, "use_listings_cache": False}


def _describe_missing_protocol(url: str, error: ImportError) -> str:
    if url.startswith(("s3://", "s3a://")):
        return "this needs s3fs, which is not installed; run: pip install 'beltscape[cluster]'"
    return f"this needs a library that is not installed ({_describe(error)})"


def _describe(error: Exception) -> str:
    """Return an exception in one line without the paths that the caller names."""
    text = getattr(error, "strerror", None) or " ".join(str(error).split())
    return text or type(error).__name__
