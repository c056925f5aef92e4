"""Certificates by the openssl program."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def certificate(folder: Path, name: str = "one", days: int = 90, *extra: str) -> tuple[Path, Path]:
    """A self-signed one for localhost and its key."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("needs the openssl program")
    cert, key = folder / f"{name}.pem", folder / f"{name}.key.pem"
    words = [
        program, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-keyout", key,
        "-out", cert, "-days", str(days), "-subj", "/CN=localhost",
        "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1",
        *(extra or ("-nodes",)),
    ]  # fmt: skip
    subprocess.run(words, check=True, capture_output=True)
    return cert, key


def ended(folder: Path) -> tuple[Path, Path]:
    """One that ended yesterday."""
    cert, key = certificate(folder, "ended")
    words = ["openssl", "x509", "-in", cert, "-signkey", key, "-days", "-1", "-out", folder / "ended.pem"]
    subprocess.run(words, check=True, capture_output=True)
    return cert, key
