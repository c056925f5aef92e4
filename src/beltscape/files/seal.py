"""Seals of files by a key of Ed25519 (RFC 8032): the last line of a page or PDF, or a value beside a document.

A seal holds a statement, the SHA-256 of the bytes before it, and the signature of both. A page and a PDF stay what
they are: the seal is a comment behind their end; that of a PDF, which readers look for, is repeated behind it. A JSON
file holds the document and its seal as two values.
"""

from __future__ import annotations

import json
import os
from base64 import b64decode, b64encode
from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beltscape.core.checks import is_dict
from beltscape.core.errors import InputError, OutputError, describe_missing_library
from beltscape.files.atomic import commit_file, describe_refusal, keep_state
from beltscape.files.paths import read_text

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

_FORMAT = "beltscape-seal/1"
_COMMENTS: Mapping[str, tuple[bytes, bytes]] = {
    ".html": (b"\n<!-- beltscape-seal ", b" -->\n"),
    ".pdf": (b"\n% beltscape-seal ", b"\n"),
}
"""By the ending of a file's name: what stands before and behind its seal."""
_LONGEST_SEAL = 16_384
"""Bytes of a seal; that of a certificate has one thousand."""


@dataclass(frozen=True, slots=True)
class Sealed:
    """A sealed file as it was read; whether it is as it was signed is another question."""

    body: bytes
    """The signed bytes."""
    statement: Any
    public_key: bytes
    signature: bytes
    sha256: str
    """Of the body, as the seal says."""

    @property
    def is_intact(self) -> bool:
        """Return whether body and statement are those that the key signed."""
        from cryptography.exceptions import InvalidSignature
        from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey

        if sha256(self.body).hexdigest() != self.sha256:
            return False
        try:
            key = Ed25519PublicKey.from_public_bytes(self.public_key)
            key.verify(self.signature, _format_signed(self.statement, self.sha256))
        except (InvalidSignature, ValueError):
            return False
        return True


class SealKey:
    """A private key that signs."""

    def __init__(self, key: Ed25519PrivateKey) -> None:
        self._key = key

    @property
    def public_key(self) -> bytes:
        """Return the public key, 32 bytes."""
        from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

        return self._key.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)

    def seal_bytes(self, body: bytes, statement: object, ending: str) -> bytes:
        """Return a page or a PDF (``ending`` ".html", ".pdf") with its seal."""
        before, behind = _COMMENTS[ending]
        seal = json.dumps(self._make_seal(body, statement), sort_keys=True, separators=(",", ":"))
        # "--" would end the comment of a page; in JSON it stands in texts only
        return body + before + seal.replace("--", "-\\u002d").encode() + behind + _find_end(body, ending)

    def seal_document(self, document: object, statement: object) -> dict[str, Any]:
        """Return a JSON document with its seal."""
        return {"document": document, "seal": self._make_seal(_format_canonical(document), statement)}

    def _make_seal(self, body: bytes, statement: object) -> dict[str, Any]:
        digest = sha256(body).hexdigest()
        signature = self._key.sign(_format_signed(statement, digest))
        return {
            "format": _FORMAT,
            "statement": statement,
            "sha256": digest,
            "public_key": b64encode(self.public_key).decode(),
            "signature": b64encode(signature).decode(),
        }


def _find_end(body: bytes, ending: str) -> bytes:
    """Return the end of a PDF, from which readers find its parts; nothing for a page."""
    return body[body.rindex(b"startxref") :] if ending == ".pdf" else b""


def _format_canonical(value: object) -> bytes:
    return json.dumps(
        value, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False
    ).encode()


def _format_signed(statement: object, digest: str) -> bytes:
    return _format_canonical({"format": _FORMAT, "sha256": digest, "statement": statement})


def read_sealed(path: Path) -> Sealed:
    """Return a sealed page, PDF or JSON file; InputError where it has no seal, or the library is missing."""
    require_signatures()
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}); give a certificate as it was issued"
        ) from error
    try:
        return _parse(data, path.suffix.lower())
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: has no seal that can be read; give a certificate as it was issued: .json, .html or .pdf"
        ) from error


def _parse(data: bytes, ending: str) -> Sealed:
    if ending in _COMMENTS:
        before, behind = _COMMENTS[ending]
        at = data.rindex(before, max(0, len(data) - _LONGEST_SEAL))
        body, text = data[:at], data[at + len(before) :]
        rest = behind + _find_end(body, ending)
        if not text.endswith(rest):
            raise ValueError("something else follows the seal")
        return _make_sealed(body, json.loads(text.removesuffix(rest)))
    whole = json.loads(data)
    return _make_sealed(_format_canonical(whole["document"]), whole["seal"])


def _make_sealed(body: bytes, seal: object) -> Sealed:
    if not is_dict(seal) or seal["format"] != _FORMAT:
        raise ValueError("no seal of this format")
    key, signature = (b64decode(seal[name], validate=True) for name in ("public_key", "signature"))
    return Sealed(body, seal["statement"], key, signature, str(seal["sha256"]))


def require_signatures() -> None:
    """Raise InputError with the line to type if nothing can be signed or verified here."""
    try:
        import cryptography.hazmat.primitives.asymmetric.ed25519  # noqa: F401
    except ImportError as error:
        raise InputError(f"certify: {describe_missing_library(error) or error}") from error


PRIVATE_KEY, PUBLIC_KEY = "key.pem", "key.pub"
"""Files of a folder with a key: PKCS #8 for the owner alone; the public key in Base64, one line."""


def open_key(folder: Path) -> SealKey:
    """Return the key of a folder, made when there is none.

    Raises
    ------
    InputError
        If one of its files is damaged, or the private one was lost; nothing is written over them.
    OutputError
        If it cannot be written.
    """
    require_signatures()
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    path, public = folder / PRIVATE_KEY, folder / PUBLIC_KEY
    if not path.exists():
        if public.exists():
            raise InputError(
                f"{path}: is lost, while {PUBLIC_KEY} is there; restore it from a backup, or move {PUBLIC_KEY} "
                "away to begin with a new key, which those who verify must get"
            )
        return _create_key(folder)
    try:
        loaded = load_pem_private_key(path.read_bytes(), None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{path}: is no private key that can be read ({error}); restore it from a backup"
        ) from error
    if not isinstance(loaded, Ed25519PrivateKey):
        raise InputError(f"{path}: is no key of Ed25519; restore the plant's own key from a backup")
    key = SealKey(loaded)
    if not public.exists():  # its program was killed before it wrote it
        _write_public(key, public)
    elif read_public_key(public) != key.public_key:
        raise InputError(f"{public}: is not that of {PRIVATE_KEY}; restore both from the same backup")
    return key


def _create_key(folder: Path) -> SealKey:
    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
    from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat

    private = Ed25519PrivateKey.generate()
    text = private.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
    key, temporary = SealKey(private), folder / f".{PRIVATE_KEY}.part"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        temporary.unlink(missing_ok=True)
        with open(temporary, "wb", opener=_open_private) as file:
            file.write(text)
        commit_file(temporary, folder / PRIVATE_KEY)
    except OSError as error:
        raise OutputError(f"{folder / PRIVATE_KEY}: {describe_refusal(error)}") from error
    _write_public(key, folder / PUBLIC_KEY)
    return key


def _write_public(key: SealKey, path: Path) -> None:
    keep_state(path, b64encode(key.public_key) + b"\n")


def _open_private(path: str, flags: int) -> int:
    return os.open(path, flags, 0o600)


def read_public_key(path: Path) -> bytes:
    """Return a public key, 32 bytes; InputError where the file holds none."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the plant's {PUBLIC_KEY}")
    try:
        key = b64decode(read_text(path).strip(), validate=True)
    except ValueError as error:
        raise InputError(f"{path}: is no public key; give the plant's {PUBLIC_KEY}") from error
    if len(key) != 32:
        raise InputError(f"{path}: is no public key of Ed25519; give the plant's {PUBLIC_KEY}")
    return key
