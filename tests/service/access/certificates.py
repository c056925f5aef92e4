"""Certificates made by the openssl program."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest


def make_certificate(folder: Path, name: str = "one", days: int = 90, *extra: str) -> tuple[Path, Path]:
    """Return a self-signed certificate for localhost and its key."""
    program = shutil.which("openssl")
    if program is None:
        pytest.skip("needs the openssl program")
    cert, key = folder / f"{name}.pem", folder / f"{name}.key.pem"
    command = [
        program, "req", "-x509", "-newkey", "ec", "-pkeyopt", "ec_paramgen_curve:prime256v1", "-keyout", key,
        "-out", cert, "-days", str(days), "-subj", "/CN=localhost",
        "-addext", "subjectAltName=DNS:localhost,IP:127.0.0.1",
        *(extra or ("-nodes",)),
    ]  # fmt: skip
    subprocess.run(command, check=True, capture_output=True)
    return cert, key


def make_expired_certificate(folder: Path) -> tuple[Path, Path]:
    """Return a certificate that expired yesterday, and its key."""
    cert, key = make_certificate(folder, "ended")
    command = ["openssl", "x509", "-in", cert, "-signkey", key, "-days", "-1", "-out", folder / "ended.pem"]
    subprocess.run(command, check=True, capture_output=True)
    return cert, key
