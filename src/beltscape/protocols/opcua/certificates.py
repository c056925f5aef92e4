"""The server's own certificate, and which certificates of clients are accepted.

In the service's data folder, ``opcua/`` holds the certificate and key that the service makes, the folder ``trusted``
with certificates of clients, of authorities that issue such, and their revocation lists, and the folder ``rejected``
with those that were refused last: an engineer moves a file from there to ``trusted``.
"""

from __future__ import annotations

import os
import re
import socket
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from ipaddress import ip_address
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.cert_gen import generate_self_signed_app_certificate
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID

from beltscape.core.errors import InputError, OutputError, describe_cause
from beltscape.files.atomic import commit_file, describe_damage, set_aside, write_durably
from beltscape.protocols.listening import (
    EVERYWHERE,
    find_routed_addresses,
    is_address,
    list_own_addresses,
    normalise_host,
)
from beltscape.protocols.settings import OpcUaSettings

_DAYS = 3650
"""Life of the certificate that the service makes: ten years, because every client must trust a new one anew."""
_KEY_BITS = (2048, 4096)
"""Shortest and longest RSA key of the policy Basic256Sha256 (OPC 10000-7)."""
_MOST_REJECTED = 50
"""Rejected certificates that are kept, which bounds the folder."""


@dataclass(frozen=True, slots=True)
class OwnCertificate:
    """The server's certificate with its key."""

    certificate: x509.Certificate
    key: rsa.RSAPrivateKey
    application: str
    """The application's unique identifier, which the certificate states."""

    @property
    def ends_soon(self) -> bool:
        """Return whether it ends within a month, or has ended."""
        return self.certificate.not_valid_after_utc < datetime.now(UTC) + timedelta(days=30)

    def describe(self) -> str:
        """Return its end and its thumbprint, by which people recognise it."""
        ends = self.certificate.not_valid_after_utc
        return f"certificate valid until {ends:%Y-%m-%d}, thumbprint {_compute_thumbprint(self.certificate)}"

    def list_missing_hosts(self, settings: OpcUaSettings) -> list[str]:
        """Return the names and addresses by which clients surely connect, and which the certificate lacks."""
        own = _list_alternative_names(self.certificate)
        named = {one.lower() for one in own.get_values_for_type(x509.DNSName)}
        named |= {str(one) for one in own.get_values_for_type(x509.IPAddress)}
        sure = {settings.host}
        if settings.host in EVERYWHERE:
            sure = find_routed_addresses() if settings.certificate is None else set[str]()
        return sorted(host for host in sure.union(settings.hosts) if normalise_host(host) not in named)


def read_certificate(settings: OpcUaSettings) -> OwnCertificate | None:
    """Return the certificate of the settings; None where they give none. InputError if it cannot be used."""
    if settings.certificate is None or settings.key is None:
        return None
    return _read_own(settings.certificate, settings.key)


def open_own_certificate(
    settings: OpcUaSettings, data: Path, on_message: Callable[[str], object] = lambda _: None
) -> OwnCertificate:
    """Return the certificate of the settings, or the one in the data folder, which is made where there is none.

    A damaged one in the data folder is set aside with a message, and another is made.

    Raises
    ------
    InputError
        If a file of the settings cannot be read, or certificate and key do not belong together.
    OutputError
        If the made certificate cannot be written.
    """
    if (given := read_certificate(settings)) is not None:
        return given
    folder = data / "opcua"
    certificate, key = folder / "certificate.der", folder / "key.pem"
    if certificate.is_file() and key.is_file():
        try:
            own = _read_own(certificate, key)
        except InputError as error:
            moved = [set_aside(path, describe_damage(path, error)) for path in (certificate, key)]
            on_message(f"opcua: {moved[0]}; another is made, which the clients must trust anew")
        else:
            if own.certificate.not_valid_after_utc > datetime.now(UTC):
                return own
    return _make_own(settings, certificate, key)


def _read_own(certificate_path: Path, key_path: Path) -> OwnCertificate:
    certificate = _load_certificate(certificate_path)
    try:
        data = key_path.read_bytes()
        load = (
            serialization.load_pem_private_key
            if b"-----BEGIN" in data
            else serialization.load_der_private_key
        )
        key = load(data, None)
    except (OSError, ValueError, TypeError) as error:
        raise InputError(
            f"{key_path}: no private key without a passphrase ({describe_cause(error)})"
        ) from error
    if not isinstance(key, rsa.RSAPrivateKey) or key.public_key() != certificate.public_key():
        raise InputError(
            f"{key_path}: is not the RSA key of {certificate_path}; give the one it was made with"
        )
    uris = _list_uris(certificate)
    if not uris:
        raise InputError(
            f"{certificate_path}: names no application URI (subjectAltName), which OPC UA requires; make a new one"
        )
    return OwnCertificate(certificate, key, uris[0])


def _make_own(settings: OpcUaSettings, certificate_path: Path, key_path: Path) -> OwnCertificate:
    host = socket.gethostname()
    name = re.sub(r"[^A-Za-z0-9._-]+", "-", settings.name)
    application = f"urn:{host}:beltscape:{name}"
    key = rsa.generate_private_key(65537, _KEY_BITS[0])
    certificate = generate_self_signed_app_certificate(
        key,
        f"Beltscape {settings.name}"[:64],
        {"organizationName": "Beltscape"},
        [x509.UniformResourceIdentifier(application), *_name_hosts(settings)],
        [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH],
        _DAYS,
    )
    pem = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    try:
        certificate_path.parent.mkdir(parents=True, exist_ok=True)
        temporary = key_path.with_name(f".{key_path.name}.part")
        with open(temporary, "wb", opener=_open_private) as file:
            file.write(key.private_bytes(*pem))
        commit_file(temporary, key_path)
        write_durably(certificate_path, certificate.public_bytes(serialization.Encoding.DER))
    except OSError as error:
        raise OutputError(
            f"{certificate_path.parent}: cannot be written ({error}); check the folder"
        ) from error
    return OwnCertificate(certificate, key, application)


def _name_hosts(settings: OpcUaSettings) -> list[x509.GeneralName]:
    """Return the names and addresses by which clients may connect: those of the settings and all of this machine."""
    hosts = {*settings.hosts, settings.host, "localhost", socket.gethostname(), socket.getfqdn()}
    hosts |= list_own_addresses()
    names = sorted({normalise_host(host) for host in hosts - set(EVERYWHERE)})
    addresses = [one for one in names if is_address(one)]
    return [
        *(x509.DNSName(one) for one in names if one not in addresses),
        *(x509.IPAddress(ip_address(one)) for one in addresses),
    ]


class ClientCertificates:
    """Decides which clients' certificates are accepted; the folders are read at every decision."""

    def __init__(self, data: Path, *, any_valid: bool) -> None:
        """Make the folders; ``any_valid``: every certificate that is valid today is accepted."""
        self.trusted, self.rejected = data / "opcua" / "trusted", data / "opcua" / "rejected"
        self._any_valid = any_valid
        for folder in (self.trusted, self.rejected):
            folder.mkdir(parents=True, exist_ok=True)

    def check(self, encoded: bytes, application: str) -> None:
        """Raise ServiceError unless a client's certificate is accepted for the application that it says to be."""
        try:
            certificate = x509.load_der_x509_certificate(encoded)
            key = certificate.public_key()
            uris = _list_uris(certificate)
        except ValueError as error:
            raise ServiceError(ua.StatusCodes.BadCertificateInvalid) from error
        if not certificate.not_valid_before_utc <= datetime.now(UTC) <= certificate.not_valid_after_utc:
            raise ServiceError(ua.StatusCodes.BadCertificateTimeInvalid)
        if not isinstance(key, rsa.RSAPublicKey) or not _KEY_BITS[0] <= key.key_size <= _KEY_BITS[1]:
            raise ServiceError(ua.StatusCodes.BadCertificatePolicyCheckFailed)
        if application not in uris:
            raise ServiceError(ua.StatusCodes.BadCertificateUriInvalid)
        if self._is_revoked(certificate):
            raise ServiceError(ua.StatusCodes.BadCertificateRevoked)
        if not self._any_valid and not self._is_trusted(certificate):
            self._keep_rejected(certificate)
            raise ServiceError(ua.StatusCodes.BadCertificateUntrusted)

    def _is_trusted(self, certificate: x509.Certificate) -> bool:
        return any(
            other == certificate or _is_issued_by(certificate, other) for other in self._list_trusted()
        )

    def _list_trusted(self) -> Iterator[x509.Certificate]:
        """Yield the readable certificates of the folder; other files are left alone."""
        for path in sorted(self.trusted.iterdir()):
            if path.suffix.lower() in (".der", ".pem", ".crt", ".cer"):
                try:
                    yield _load_certificate(path)
                except InputError:
                    continue

    def _is_revoked(self, certificate: x509.Certificate) -> bool:
        for path in self.trusted.glob("*.crl"):
            data = path.read_bytes()
            try:
                load = x509.load_pem_x509_crl if b"-----BEGIN" in data else x509.load_der_x509_crl
                revoked = load(data)
            except ValueError:
                continue
            is_issuer = revoked.issuer == certificate.issuer
            if is_issuer and revoked.get_revoked_certificate_by_serial_number(certificate.serial_number):
                return True
        return False

    def _keep_rejected(self, certificate: x509.Certificate) -> None:
        kept = sorted(self.rejected.glob("*.der"), key=lambda path: path.stat().st_mtime)
        for path in kept[: max(0, len(kept) - _MOST_REJECTED + 1)]:
            path.unlink(missing_ok=True)
        path = self.rejected / f"{_compute_thumbprint(certificate)}.der"
        try:
            path.write_bytes(certificate.public_bytes(serialization.Encoding.DER))
        except OSError:
            return  # a full disk must not decide who enters


def _is_issued_by(certificate: x509.Certificate, authority: x509.Certificate) -> bool:
    """Return whether a valid authority signed a certificate."""
    try:
        limits = authority.extensions.get_extension_for_class(x509.BasicConstraints).value
        certificate.verify_directly_issued_by(authority)
    except (x509.ExtensionNotFound, InvalidSignature, ValueError, TypeError):
        return False
    now = datetime.now(UTC)
    return limits.ca and authority.not_valid_before_utc <= now <= authority.not_valid_after_utc


def _load_certificate(path: Path) -> x509.Certificate:
    try:
        data = path.read_bytes()
        load = x509.load_pem_x509_certificate if b"-----BEGIN" in data else x509.load_der_x509_certificate
        return load(data)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: no certificate, PEM or DER ({describe_cause(error)})") from error


def _list_uris(certificate: x509.Certificate) -> list[str]:
    return _list_alternative_names(certificate).get_values_for_type(x509.UniformResourceIdentifier)


def _list_alternative_names(certificate: x509.Certificate) -> x509.SubjectAlternativeName:
    try:
        return certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    except x509.ExtensionNotFound:
        return x509.SubjectAlternativeName(())


def _compute_thumbprint(certificate: x509.Certificate) -> str:
    """Return the SHA-1 of a certificate, which OPC UA calls its thumbprint (OPC 10000-6)."""
    from cryptography.hazmat.primitives.hashes import SHA1

    return certificate.fingerprint(SHA1()).hex().upper()


def _open_private(path: str, flags: int) -> int:
    """Open a file that only its owner may read."""
    return os.open(path, flags, 0o600)
