"""The certificates of a plant: issued with its key, kept in its data folder, and the one that is in force.

The folder ``certificates`` of the data folder has a file NUMBER.json and a page NUMBER.html of each, and the key. No
file of an issued certificate is written again; the newest one is in force. What is asked for a second time, such as
after a kill, is the certificate that is there.
"""

from __future__ import annotations

import json
import os
import threading
from base64 import b64decode
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from time import time_ns
from typing import Any

from beltscape.core.errors import InputError, OutputError
from beltscape.core.events import CertificateReading
from beltscape.core.system_calls import lock_folder
from beltscape.files.atomic import commit_file, describe_refusal
from beltscape.files.json_text import to_plain
from beltscape.files.seal import (
    PUBLIC_KEY,
    SealKey,
    open_key,
    read_public_key,
    read_sealed,
    require_signatures,
)
from beltscape.metrology.certificate import (
    CertificateState,
    Statement,
    assess_certificate,
    make_fingerprint,
    parse_statement,
)
from beltscape.pipeline.certifying.material_test import EvaluatedTest
from beltscape.report.metrology.certificate import render_certificate
from beltscape.report.production.pdf import make_pdf

FOLDER = "certificates"
"""In the data folder."""
VALID_DAYS = 365
"""Default validity: a year, as of belt scales in use for trade in most countries."""
_DAY_MS = 86_400_000
"""Milliseconds of a day."""


@dataclass(frozen=True, slots=True)
class IssueOptions:
    """How a certificate is issued."""

    plant: str
    by: str
    """Who issues it."""
    now_ms: int
    valid_days: float = VALID_DAYS
    language: str = "en"
    zone: str = "UTC"
    pdf: bool = False
    """Whether a PDF is written, too."""


@dataclass(frozen=True, slots=True)
class IssuedCertificate:
    """A certificate of the folder."""

    statement: Statement
    path: Path
    """Its JSON file."""
    fingerprint: str
    request: str = ""
    """SHA-256 of what was asked for (`_hash_request`); empty in one of an earlier version."""
    is_new: bool = False
    """False where it was there before."""

    @property
    def page(self) -> Path:
        """Return its page."""
        return self.path.with_suffix(".html")


def issue_certificate(data: Path, evaluated: EvaluatedTest, options: IssueOptions) -> IssuedCertificate:
    """Sign the certificate of a test and put it in force; return it.

    Where the newest one has not expired and was issued for the same test by the same options, it is returned instead,
    and forms of it that are missing are written: a program that was killed draws no second number.

    Raises
    ------
    InputError
        If it cannot be signed here, nothing is determined, or another program issues one.
    OutputError
        If it cannot be written; then none is in force that was not before.
    """
    if not evaluated.document["results"]:
        raise InputError("certify: the test determines no result, so there is nothing to certify")
    require_signatures()
    folder, request = data / FOLDER, _hash_request(evaluated, options)
    with _lock(folder):
        key = open_key(folder)
        fingerprint = make_fingerprint(key.public_key)
        before = _find_issued(data, fingerprint, request, options.now_ms)
        statement = (
            before.statement
            if before is not None
            else Statement(
                number=_find_number(folder, options.now_ms),
                plant=options.plant,
                issued_ms=options.now_ms,
                expires_ms=options.now_ms + round(options.valid_days * _DAY_MS),
                issued_by=options.by,
                applies=dict(evaluated.document["applies"]),
            )
        )
        files = _make_files(key, statement, evaluated, options, request)
        if before is not None:
            files = {name: content for name, content in files.items() if not (folder / name).exists()}
        _write_new(folder, files)
    path = folder / f"{statement.number}.json"
    return IssuedCertificate(statement, path, fingerprint, request, is_new=before is None)


@contextmanager
def _lock(folder: Path) -> Generator[None]:
    """Let one program at a time draw a number."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = lock_folder(folder)
    except BlockingIOError as error:
        raise InputError(
            f"{folder}: another program issues a certificate; try again when it is done"
        ) from error
    except OSError as error:
        raise OutputError(f"{folder}: {describe_refusal(error)}") from error
    try:
        yield
    finally:
        os.close(handle)


def _hash_request(evaluated: EvaluatedTest, options: IssueOptions) -> str:
    """Return the SHA-256 of test and options, except the time."""
    asked = [evaluated.document, options.plant, options.by, options.valid_days, options.language]
    return sha256(json.dumps(to_plain(asked), sort_keys=True).encode()).hexdigest()


def _find_issued(data: Path, fingerprint: str, request: str, now_ms: int) -> IssuedCertificate | None:
    """Return the certificate in force where it is what is asked for; None for any other."""
    newest = find_in_force(data)
    if newest is None or (newest.request, newest.fingerprint) != (request, fingerprint):
        return None
    return newest if newest.statement.days_left(now_ms) > 0 else None


def _make_files(
    key: SealKey, statement: Statement, evaluated: EvaluatedTest, options: IssueOptions, request: str
) -> dict[str, bytes]:
    """Return contents by name; the JSON, by which a certificate is in force, is the first."""
    plain, number = statement.to_plain(), statement.number
    page = render_certificate(
        evaluated.document,
        evaluated.pictures,
        options.language,
        options.zone,
        statement=statement,
        fingerprint=make_fingerprint(key.public_key),
    )
    sealed = key.seal_document(to_plain({**evaluated.document, "certificate": plain}), plain)
    sealed["request"] = request
    files = {f"{number}.json": (json.dumps(sealed, indent=1, ensure_ascii=False) + "\n").encode()}
    files[f"{number}.html"] = key.seal_bytes(page.encode(), plain, ".html")
    if options.pdf:
        files[f"{number}.pdf"] = key.seal_bytes(make_pdf(page, "--pdf"), plain, ".pdf")
    return files


def _find_number(folder: Path, now_ms: int) -> str:
    """Return the next number of the year, such as 2026-0003."""
    year = datetime.fromtimestamp(now_ms / 1000, UTC).year
    taken = [int(path.stem[5:]) for path in folder.glob(f"{year}-[0-9][0-9][0-9][0-9].*")]
    return f"{year}-{max(taken, default=0) + 1:04d}"


def _write_new(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files that are not there: all contents first, which a full disk may refuse, then names in their order.

    A kill in between leaves none of them, or the first ones; what is missing then is written when they are asked for
    again.
    """
    parts = {name: folder / f".{name}.part" for name in files}
    for name in files:
        if (folder / name).exists():
            raise OutputError(f"{folder / name}: exists; a certificate is never written again")
    try:
        for name, content in files.items():
            parts[name].write_bytes(content)
        for name, part in parts.items():
            commit_file(part, folder / name)
    except OSError as error:
        raise OutputError(f"{folder / next(iter(files))}: {describe_refusal(error)}") from error
    finally:
        for part in parts.values():
            part.unlink(missing_ok=True)


def list_certificates(data: Path) -> list[IssuedCertificate]:
    """Return the certificates of a data folder, the newest first; files that are damaged are left out."""
    found: list[IssuedCertificate] = []
    for path in (data / FOLDER).glob("[0-9][0-9][0-9][0-9]-[0-9][0-9][0-9][0-9].json"):
        statement, key, request = read_statement(path)
        if statement is not None:
            found.append(IssuedCertificate(statement, path, make_fingerprint(key), request))
    return sorted(found, key=lambda one: (one.statement.issued_ms, one.statement.number), reverse=True)


def read_statement(path: Path) -> tuple[Statement | None, bytes, str]:
    """Return statement, public key and request of a certificate's JSON, unverified; None where it cannot be read.

    Needs no library of signatures, so that a running plant knows its certificate without one.
    """
    try:
        sealed = json.loads(path.read_bytes())
        seal = sealed["seal"]
        key = b64decode(seal["public_key"], validate=True)
        return parse_statement(seal["statement"]), key, str(sealed.get("request", ""))
    except (OSError, ValueError, KeyError, TypeError):
        return None, b"", ""


def find_in_force(data: Path) -> IssuedCertificate | None:
    """Return the newest certificate; None if there is none."""
    return next(iter(list_certificates(data)), None)


def read_document(path: Path) -> Mapping[str, Any]:
    """Return the test's document of a certificate's JSON; InputError where it cannot be read."""
    try:
        return json.loads(path.read_bytes())["document"]
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: is no certificate that can be read ({error}); restore it from a backup"
        ) from error


def verify_certificate(
    path: Path, now_ms: int, *, trusted_key: bytes | None = None, present: Mapping[str, str] | None = None
) -> CertificateState:
    """Return whether a certificate holds: its JSON, page or PDF.

    ``trusted_key`` is the plant's public key, ``present`` what the plant measures by now; None: not known.

    Raises
    ------
    InputError
        If the file has no seal, or signatures cannot be verified here.
    """
    sealed = read_sealed(path)
    try:
        statement = parse_statement(sealed.statement)
    except ValueError as error:
        raise InputError(f"{path}: {error}; give a certificate as it was issued") from error
    return assess_certificate(
        statement,
        sealed.public_key,
        now_ms,
        is_signed=sealed.is_intact,
        trusted_key=trusted_key,
        present=present,
    )


def read_plant_key(data: Path) -> bytes:
    """Return the public key of a plant's data folder; InputError if it has issued no certificate."""
    path = data / FOLDER / PUBLIC_KEY
    if not path.is_file() and find_in_force(data) is not None:
        raise InputError(f"{path}: is lost; restore it from a backup, or give the plant's key by --key")
    if not path.is_file():
        raise InputError(
            f"{path}: no such file; this plant has issued no certificate, or give its key by --key"
        )
    return read_public_key(path)


def read_wall_ms() -> int:
    """Return the system clock, ms since 1970."""
    return time_ns() // 1_000_000


class CertificateWatch:
    """Reads the folder of certificates when it has changed; may be called from any thread, twice a second."""

    def __init__(self, data: Path, now_ms: Callable[[], int] = read_wall_ms) -> None:
        """``data`` is the data folder."""
        self._data, self._now_ms = data, now_ms
        self._lock = threading.Lock()
        self._changed_ns: int | None = None
        self._statement: Statement | None = None

    def __call__(self, present: Mapping[str, str]) -> CertificateReading | None:
        """Return the newest certificate, against what is measured by now; None without one."""
        statement = self._read()
        if statement is None:
            return None
        days_left = statement.days_left(self._now_ms())
        return CertificateReading(statement.number, days_left, statement.list_changed(present))

    def _read(self) -> Statement | None:
        with self._lock:
            try:
                changed_ns = (self._data / FOLDER).stat().st_mtime_ns
            except OSError:
                return None
            if changed_ns != self._changed_ns:
                newest = find_in_force(self._data)
                self._statement = None if newest is None else newest.statement
                self._changed_ns = changed_ns
            return self._statement
