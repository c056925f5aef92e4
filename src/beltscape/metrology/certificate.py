"""The statement of a certificate, and whether it holds: signature, signer, validity, and what it applies to."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from beltscape.core.checks import is_dict

APPLIES: tuple[str, ...] = ("rig", "empty", "settings", "networks", "program")
"""What a certificate applies to: parts of a run's provenance, in the order in which changes are named."""
_DAY_MS = 86_400_000
"""Milliseconds of a day."""
Verdict = Literal["valid", "intact", "other key", "altered", "not yet valid", "expired", "no longer applies"]
"""intact: as it was signed, but no key of a plant was given to compare with; the others as they say"""


@dataclass(frozen=True, slots=True)
class Statement:
    """The signed statement of a certificate; it is in every form of it, also where its figures are not."""

    number: str
    plant: str
    issued_ms: int
    expires_ms: int
    issued_by: str
    applies: Mapping[str, str]
    """By part: version of the program, SHA-256 of the others; a part that was not recorded is absent."""

    def to_plain(self) -> dict[str, Any]:
        """Return it for JSON."""
        return {
            "number": self.number,
            "plant": self.plant,
            "issued_ms": self.issued_ms,
            "expires_ms": self.expires_ms,
            "issued_by": self.issued_by,
            "applies": dict(self.applies),
        }

    def days_left(self, now_ms: int) -> float:
        """Return the days until it expires; negative afterwards."""
        return (self.expires_ms - now_ms) / _DAY_MS

    def is_in_force(self, now_ms: int, present: Mapping[str, str]) -> bool:
        """Return whether it has not expired, and nothing that it applies to has changed."""
        return self.days_left(now_ms) >= 0 and not self.list_changed(present)

    def list_changed(self, present: Mapping[str, str]) -> tuple[str, ...]:
        """Return the parts of the provenance that differ now; those that either side does not know are left out."""
        known = (part for part in APPLIES if self.applies.get(part) and present.get(part))
        return tuple(part for part in known if self.applies[part] != present[part])


def parse_statement(value: object) -> Statement:
    """Return the statement of `to_plain`; ValueError for anything else."""
    if not is_dict(value) or not is_dict(value.get("applies")):
        raise ValueError("has no statement")
    texts, times = ("number", "plant", "issued_by"), ("issued_ms", "expires_ms")
    if not all(isinstance(value.get(key), str) for key in texts):
        raise ValueError("its statement lacks a text")
    if not all(type(value.get(key)) is int for key in times):
        raise ValueError("its statement lacks a time")
    applies = {str(key): str(part) for key, part in value["applies"].items()}
    return Statement(**{key: value[key] for key in (*texts, *times)}, applies=applies)


def make_fingerprint(public_key: bytes) -> str:
    """Return the first 16 digits of the SHA-256 of a public key, in groups of four, to be compared by eye."""
    digits = hashlib.sha256(public_key).hexdigest()[:16]
    return " ".join(digits[at : at + 4] for at in range(0, len(digits), 4))


@dataclass(frozen=True, slots=True)
class CertificateState:
    """The result of a verification."""

    verdict: Verdict
    """The first of what is wrong, in the order signature, signer, time, application."""
    statement: Statement
    fingerprint: str
    """Of the key that signed it."""
    days_left: float
    changed: tuple[str, ...]
    """Parts of the provenance that differ from the certificate's; empty also where they are not known."""


def assess_certificate(
    statement: Statement,
    public_key: bytes,
    now_ms: int,
    *,
    is_signed: bool,
    trusted_key: bytes | None,
    present: Mapping[str, str] | None,
) -> CertificateState:
    """Return whether a certificate holds; ``trusted_key`` and ``present`` None: they are not known."""
    changed = () if present is None else statement.list_changed(present)
    days_left = statement.days_left(now_ms)
    checks: tuple[tuple[Verdict, bool], ...] = (
        ("altered", not is_signed),
        ("other key", trusted_key is not None and trusted_key != public_key),
        ("not yet valid", now_ms < statement.issued_ms - _DAY_MS),
        ("expired", days_left < 0),
        ("no longer applies", bool(changed)),
        ("intact", trusted_key is None),
    )
    verdict: Verdict = next((name for name, holds in checks if holds), "valid")
    return CertificateState(verdict, statement, make_fingerprint(public_key), days_left, changed)
