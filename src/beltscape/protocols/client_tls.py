"""TLS of a client: the server's certificate and name are checked."""

from __future__ import annotations

import ssl
from pathlib import Path


def make_client_context(
    authority: Path | None, certificate: Path | None = None, key: Path | None = None
) -> ssl.SSLContext:
    """Return TLS that checks the server's certificate and name.

    ``authority`` is a PEM file; None: the system's authorities. ``certificate`` and ``key`` are this client's own.

    Raises
    ------
    OSError
        If a file cannot be read, or does not hold what it should.
    """
    context = ssl.create_default_context(cafile=None if authority is None else str(authority))
    if certificate is not None:
        context.load_cert_chain(certificate, key)
    return context
