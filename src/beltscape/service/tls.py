"""The TLS certificate: checked when the service starts, its expiry also while it runs."""

from __future__ import annotations

import ssl
import time
from pathlib import Path

from beltscape.core.errors import InputError

SOON_DAYS = 30
"""A certificate that expires within this time is reported, as by the alarm's default."""
_DAY_S = 86_400.0
"""Seconds of a day."""
_NO_CHECK_TIME = 0x200000
"""X509_V_FLAG_NO_CHECK_TIME of OpenSSL (x509_vfy.h)."""


def create_tls_context(certificate: Path, key: Path) -> ssl.SSLContext:
    """Return a server context for TLS 1.2 or later. InputError with file and fix if they cannot be used."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.minimum_version = ssl.TLSVersion.TLSv1_2
    context.options |= ssl.OP_NO_COMPRESSION | ssl.OP_NO_RENEGOTIATION | ssl.OP_CIPHER_SERVER_PREFERENCE
    context.set_ciphers("ECDHE+AESGCM:ECDHE+CHACHA20")
    for path, kind in ((certificate, "certificate"), (key, "key")):
        _check_readable(path, kind)
    try:
        context.load_cert_chain(certificate, key, password=lambda: _refuse_passphrase(key))
    except ssl.SSLError as error:
        raise InputError(_describe_error(certificate, key, error)) from error
    return context


def read_expiry(certificate: Path, key: Path) -> float:
    """Return when the certificate expires, seconds since 1970.

    The standard library decodes no leaf certificate from a file, so a server with it and a client that trusts only it
    perform a handshake in memory. InputError if that fails, as it would in a browser. An expired certificate, or one
    that is not valid yet, is no error.
    """
    server = create_tls_context(certificate, key)  # raises InputError if the files cannot be used
    client = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    client.check_hostname = False
    # expired certificates are accepted here: the service must start with one after a power failure, and report it
    client.verify_flags |= ssl.VerifyFlags(ssl.VERIFY_X509_PARTIAL_CHAIN | _NO_CHECK_TIME)
    client.load_verify_locations(certificate)
    to_client, to_server = ssl.MemoryBIO(), ssl.MemoryBIO()
    server_end = server.wrap_bio(to_server, to_client, server_side=True)
    client_end = client.wrap_bio(to_client, to_server)
    for _ in range(4):
        for end in (client_end, server_end):
            try:
                end.do_handshake()
            except ssl.SSLWantReadError:
                continue
            except ssl.SSLCertVerificationError as error:
                raise InputError(f"{certificate}: {error.verify_message}; make a new certificate") from error
    ends = (client_end.getpeercert() or {}).get("notAfter")
    if not isinstance(ends, str):
        raise InputError(f"{certificate}: cannot be used for TLS; make a new certificate")
    return ssl.cert_time_to_seconds(ends)


class CertificateExpiry:
    """The days until the served certificate expires; NaN without one."""

    def __init__(self, certificate: Path | None, key: Path | None) -> None:
        """Read the certificate; InputError if it cannot be used."""
        self.expiry_s = self.read(certificate, key)
        """When it expires, seconds since 1970; NaN without one."""

    @staticmethod
    def read(certificate: Path | None, key: Path | None) -> float:
        """Return when a certificate expires, seconds since 1970; NaN without one. InputError if it cannot be used."""
        return float("nan") if certificate is None or key is None else read_expiry(certificate, key)

    def __call__(self) -> float:
        """Return the days from now."""
        return (self.expiry_s - time.time()) / _DAY_S


def describe_expiry(certificate: Path, key: Path, now_s: float | None = None) -> str | None:
    """Return one line about a certificate that fails or expires soon; None if it is valid for a month or more."""
    try:
        days = (read_expiry(certificate, key) - (time.time() if now_s is None else now_s)) / 86_400
    except InputError as error:
        return str(error)
    if days > SOON_DAYS:
        return None
    when = "has ended" if days <= 0 else f"ends in {days:.0f} days"
    return f"{certificate}: the certificate {when}; make a new one and start the service again"


def _check_readable(path: Path, kind: str) -> None:
    try:
        path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: the TLS {kind} cannot be read ({error.strerror})") from error


def _refuse_passphrase(key: Path) -> str:
    raise InputError(f"{key}: has a passphrase; give the key without one, readable for the service alone")


def _describe_error(certificate: Path, key: Path, error: ssl.SSLError) -> str:
    if error.reason == "KEY_VALUES_MISMATCH":
        return f"{key}: is not the key of {certificate}; give the one it was made with"
    if b"-----BEGIN CERTIFICATE-----" not in certificate.read_bytes():
        return (
            f"{certificate}: holds no PEM certificate; convert it (openssl x509 -in … -out certificate.pem)"
        )
    if b"PRIVATE KEY-----" not in key.read_bytes():
        return f"{key}: holds no PEM private key; convert it (openssl pkey -in … -out key.pem)"
    return f"{certificate}, {key}: cannot be used for TLS ({error.reason or error})"
