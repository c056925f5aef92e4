"""OPC UA: authorities that issue certificates of clients, and revocation lists."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from asyncua import ua
from asyncua.common.utils import ServiceError
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from beltscape.protocols.listening import list_own_addresses
from beltscape.protocols.opcua.certificates import ClientCertificates, open_own_certificate
from beltscape.protocols.settings import OpcUaSettings
from tests.protocols.opcua import APPLICATION


def make_issued(
    *, is_authority: bool = True, days: int = 30
) -> tuple[x509.Certificate, x509.Certificate, bytes]:
    """Return an issuer's certificate, one that it issued to a client, and its list that revokes this one."""
    keys = [rsa.generate_private_key(65537, 2048) for _ in range(2)]
    names = [x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, one)]) for one in ("issuer", "client")]
    now = datetime.now(UTC)
    made = list[x509.Certificate]()
    for k, end in ((0, days), (1, 30)):
        uri = x509.SubjectAlternativeName([x509.UniformResourceIdentifier(APPLICATION)])
        limits = x509.BasicConstraints(ca=k == 0 and is_authority, path_length=None)
        builder = x509.CertificateBuilder().subject_name(names[k]).issuer_name(names[0])
        builder = builder.public_key(keys[k].public_key()).serial_number(x509.random_serial_number())
        builder = builder.not_valid_before(now - timedelta(days=60)).not_valid_after(
            now + timedelta(days=end)
        )
        builder = builder.add_extension(uri, critical=False).add_extension(limits, critical=True)
        made.append(builder.sign(keys[0], hashes.SHA256()))
    revoked = (
        x509.RevokedCertificateBuilder().serial_number(made[1].serial_number).revocation_date(now).build()
    )
    listed = x509.CertificateRevocationListBuilder().issuer_name(names[0]).last_update(now)
    listed = listed.next_update(now + timedelta(days=1)).add_revoked_certificate(revoked)
    return made[0], made[1], listed.sign(keys[0], hashes.SHA256()).public_bytes(Encoding.DER)


def test_certificates_of_a_trusted_authority_enter_until_they_are_revoked(tmp_path: Path) -> None:
    clients = ClientCertificates(tmp_path, any_valid=False)
    authority, client, revocation = make_issued()
    shown = client.public_bytes(Encoding.DER)
    with pytest.raises(ServiceError) as refused:
        clients.check(shown, APPLICATION)
    assert refused.value.code == ua.StatusCodes.BadCertificateUntrusted
    (clients.trusted / "authority.pem").write_bytes(authority.public_bytes(Encoding.PEM))
    (clients.trusted / "notes.txt").write_text("not a certificate")
    (clients.trusted / "broken.der").write_bytes(b"not a certificate either")
    clients.check(shown, APPLICATION)
    (clients.trusted / "authority.crl").write_bytes(revocation)
    with pytest.raises(ServiceError) as refused:
        clients.check(shown, APPLICATION)
    assert refused.value.code == ua.StatusCodes.BadCertificateRevoked


@pytest.mark.parametrize(("is_authority", "days"), [(False, 30), (True, -1)])
def test_others_may_not_issue_certificates(tmp_path: Path, is_authority: bool, days: int) -> None:
    clients = ClientCertificates(tmp_path, any_valid=False)
    issuer, client, _ = make_issued(is_authority=is_authority, days=days)
    (clients.trusted / "issuer.der").write_bytes(issuer.public_bytes(Encoding.DER))
    with pytest.raises(ServiceError) as refused:
        clients.check(client.public_bytes(Encoding.DER), APPLICATION)
    assert refused.value.code == ua.StatusCodes.BadCertificateUntrusted


def test_the_made_certificate_names_every_address_by_which_clients_connect(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("socket.gethostname", lambda: "Belt4")
    everywhere = OpcUaSettings(host="0.0.0.0", hosts=("belt4.plant.example", "192.0.2.17", "2001:DB8:0::4"))
    own = open_own_certificate(everywhere, tmp_path)
    names = own.certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName).value
    assert {"belt4", "localhost", "belt4.plant.example"} <= set(names.get_values_for_type(x509.DNSName))
    addresses = {str(one) for one in names.get_values_for_type(x509.IPAddress)}
    assert addresses >= {"192.0.2.17", "2001:db8::4", "127.0.0.1", "::1"} | list_own_addresses()
    assert own.list_missing_hosts(everywhere) == []
    kept = open_own_certificate(everywhere, tmp_path)
    assert (
        kept.certificate == own.certificate
    )  # clients trust it: it is not made anew where an address changes
    moved = OpcUaSettings(host="192.0.2.99", hosts=("BELT4",))
    assert kept.list_missing_hosts(moved) == ["192.0.2.99"]
    monkeypatch.setattr(
        "beltscape.protocols.opcua.certificates.find_routed_addresses", lambda: {"192.0.2.50"}
    )
    assert kept.list_missing_hosts(everywhere) == ["192.0.2.50"]


@pytest.mark.parametrize("damaged", ["certificate.der", "key.pem"])
def test_a_damaged_certificate_of_its_own_is_set_aside_and_made_anew(tmp_path: Path, damaged: str) -> None:
    settings, messages = OpcUaSettings(), list[str]()
    first = open_own_certificate(settings, tmp_path, messages.append)
    assert (tmp_path / "opcua" / "key.pem").stat().st_mode & 0o777 == 0o600
    (tmp_path / "opcua" / damaged).write_bytes(b"")
    second = open_own_certificate(settings, tmp_path, messages.append)
    assert second.certificate != first.certificate
    (message,) = messages
    assert "moved to" in message and message.endswith("another is made, which the clients must trust anew")
    kept = {path.name for path in (tmp_path / "opcua" / "damaged").rglob("*") if path.is_file()}
    assert kept == {"certificate.der", "key.pem"}
    assert open_own_certificate(settings, tmp_path, messages.append).certificate == second.certificate
    assert len(messages) == 1
