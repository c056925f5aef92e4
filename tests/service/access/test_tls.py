"""TLS certificates: their check, their expiry, and errors in one line."""

from __future__ import annotations

import ssl
import time

import pytest

from beltscape.core.errors import InputError
from beltscape.service.tls import create_tls_context, describe_expiry, read_expiry
from tests.service.access.certificates import make_certificate, make_expired_certificate


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    return make_certificate(tmp_path_factory.mktemp("tls"))


def test_a_valid_certificate_is_accepted(pair):
    context = create_tls_context(*pair)
    assert context.minimum_version is ssl.TLSVersion.TLSv1_2
    assert read_expiry(*pair) == pytest.approx(time.time() + 90 * 86_400, abs=120)
    assert describe_expiry(*pair) is None


def test_expiry_is_reported_a_month_before(pair):
    now = time.time()
    assert describe_expiry(pair[0], pair[1], now + 59 * 86_400) is None
    note = describe_expiry(pair[0], pair[1], now + 70 * 86_400)
    assert note == f"{pair[0]}: the certificate ends in 20 days; make a new one and start the service again"
    assert "has ended" in str(describe_expiry(pair[0], pair[1], now + 91 * 86_400))


def test_an_expired_certificate_is_reported_and_still_served(tmp_path):
    """After a power failure the service must start even with an expired certificate."""
    pair = make_expired_certificate(tmp_path)
    assert time.time() - 2 * 86_400 < read_expiry(*pair) < time.time()
    assert "has ended; make a new one" in str(describe_expiry(*pair))
    assert create_tls_context(*pair)


def test_a_key_of_another_certificate_is_refused(pair, tmp_path):
    _, other = make_certificate(tmp_path, "other")
    with pytest.raises(InputError, match=r"other\.key\.pem: is not the key of .*one\.pem"):
        create_tls_context(pair[0], other)


def test_unusable_files_are_refused(pair, tmp_path):
    cert, key = pair
    with pytest.raises(InputError, match=r"gone\.pem: the TLS certificate cannot be read \(No such file"):
        create_tls_context(tmp_path / "gone.pem", key)
    with pytest.raises(InputError, match=r"gone\.pem: the TLS key cannot be read"):
        create_tls_context(cert, tmp_path / "gone.pem")
    nonsense = tmp_path / "nonsense.pem"
    nonsense.write_bytes(b"\x30\x82")
    with pytest.raises(InputError, match=r"nonsense\.pem: holds no PEM certificate; convert it"):
        create_tls_context(nonsense, key)
    with pytest.raises(InputError, match=r"nonsense\.pem: holds no PEM private key; convert it"):
        create_tls_context(cert, nonsense)


def test_a_key_with_a_passphrase_is_refused(tmp_path):
    pair = make_certificate(tmp_path, "locked", 90, "-passout", "pass:secret")
    with pytest.raises(InputError, match=r"locked\.key\.pem: has a passphrase; give the key without one"):
        create_tls_context(*pair)
