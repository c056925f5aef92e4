"""OPC UA: who enters, and what garbage, crowds and restarts do to the server."""

from __future__ import annotations

import asyncio
import random
import socket
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from beltscape.core.errors import InputError

pytest.importorskip("asyncua", reason="asyncua is not installed; pip install 'beltscape[opcua]' brings it")

from asyncua import Client, ua

from beltscape.protocols.opcua.certificates import open_own_certificate
from beltscape.protocols.opcua.server import OpcUaServer
from beltscape.protocols.settings import OpcUaSettings
from tests.protocols.opcua import APPLICATION, CommandedPlant, Running, call, find, make_certificate, wait_for
from tests.thorough import THOROUGH

VOLUME = "Belt.Totals.Volume"
SIGN = ua.MessageSecurityMode.Sign


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("clients")


@pytest.fixture(scope="module")
def trusted(folder: Path) -> tuple[Path, Path]:
    return make_certificate(folder, "trusted")


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory, trusted: tuple[Path, Path]) -> Iterator[Running]:
    """Start a server with the default settings, once for the module."""
    one = Running(tmp_path_factory.mktemp("opcua"))
    one.trust(trusted[0])
    yield one
    one.server.close()


def read_volume(running: Running, *arguments: object, **options: object) -> float:
    """Sign in and read one value."""

    async def work() -> float:
        async with await running.make_client(*arguments, **options) as client:  # pyrefly: ignore[bad-argument-type]
            return await find(client, VOLUME).read_value()

    return call(work)


def refuse(code: str, running: Running, *arguments: object, **options: object) -> None:
    with pytest.raises(ua.UaStatusCodeError, match=code):
        read_volume(running, *arguments, **options)


def test_users_enter_signed_and_encrypted(running: Running, trusted) -> None:
    assert read_volume(running, trusted, "vera") == 0.0
    assert read_volume(running, trusted, "vera", mode=SIGN) == 0.0
    assert ("vera", "127.0.0.1") in running.plant.users.attempts


@pytest.fixture
def careless(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let clients open sessions on channels that the server does not offer."""
    monkeypatch.setattr(Client, "find_endpoint", staticmethod(lambda endpoints, *_: next(iter(endpoints))))


@pytest.mark.usefixtures("careless")
def test_nobody_enters_without_sign_in(running: Running, trusted) -> None:
    refuse("BadIdentityTokenRejected", running, trusted)
    refuse("BadSecurityModeRejected", running, None, "vera")
    refuse("Bad", running)


def test_wrong_names_and_passwords_are_refused(running: Running, trusted) -> None:
    refuse("BadUserAccessDenied", running, trusted, "vera", "wrong")
    refuse("BadUserAccessDenied", running, trusted, "admin")
    refuse("BadUserAccessDenied", running, trusted, "Admin")
    refuse("BadUserAccessDenied", running, trusted, "nobody")


def test_an_unknown_certificate_is_kept_until_an_engineer_trusts_it(running: Running, folder: Path) -> None:
    new = make_certificate(folder, "new")
    refuse("BadCertificateUntrusted", running, new, "vera")
    (kept,) = [
        path
        for path in (running.data / "opcua/rejected").iterdir()
        if path.read_bytes() == new[0].read_bytes()
    ]
    kept.rename(running.data / "opcua/trusted" / kept.name)
    assert read_volume(running, new, "vera") == 0.0
    (running.data / "opcua/trusted" / kept.name).unlink()
    refuse("BadCertificateUntrusted", running, new, "vera")


def test_unfit_certificates_are_refused_even_if_trusted(running: Running, folder: Path) -> None:
    expired = make_certificate(folder, "expired", days=-1)
    another = make_certificate(folder, "another", application="urn:someone:else")
    short = make_certificate(folder, "short", bits=1024)
    for certificate in (expired, another, short):
        running.trust(certificate[0])
    refuse("BadCertificateTimeInvalid", running, expired, "vera")
    refuse("BadCertificateUriInvalid", running, another, "vera")
    with pytest.raises(ua.UaError):
        read_volume(running, short, "vera")


def test_a_trusted_certificate_in_the_session_does_not_admit_another_channel(
    running: Running, folder: Path, trusted, monkeypatch: pytest.MonkeyPatch
) -> None:
    stranger = make_certificate(folder, "stranger")

    async def work() -> None:
        client = await running.make_client(stranger, "vera")
        await client.connect_socket()
        await client.send_hello()
        await client.open_secure_channel()
        monkeypatch.setattr(client.security_policy.asymmetric_cryptography, "verify", lambda *_: None)
        client.security_policy.host_certificate = trusted[0].read_bytes()  # public: anybody may show it
        try:
            with pytest.raises(ua.UaStatusCodeError):
                await client.create_session()
                await client.activate_session(username="vera", password="four seasons of ore")
            with pytest.raises((ua.UaStatusCodeError, ConnectionError, asyncio.TimeoutError)):
                await find(client, VOLUME).read_value()
        finally:
            client.disconnect_socket()

    call(work)


@pytest.mark.usefixtures("careless")
def test_a_session_without_a_user_reads_nothing(running: Running, trusted) -> None:
    async def work() -> None:
        for certificate in (trusted, None):
            client = await running.make_client(certificate)
            await client.connect_socket()
            try:
                await client.send_hello()
                await client.open_secure_channel()
                await client.create_session()
                with pytest.raises(ua.UaStatusCodeError, match=r"BadSessionNotActivated|BadUserAccessDenied"):
                    await find(client, VOLUME).read_value()
                with pytest.raises(ua.UaStatusCodeError):
                    await find(client, "Belt.Commands").call_method("2:StopBatch")
            finally:
                client.disconnect_socket()

    call(work)


def test_a_session_cannot_be_taken_over_from_another_channel(running: Running, trusted) -> None:
    async def work() -> None:
        async with await running.make_client(trusted, "otto") as owner:
            thief = await running.make_client(trusted, "otto", "wrong")
            await thief.connect_socket()
            try:
                await thief.send_hello()
                await thief.open_secure_channel()
                thief.uaclient.protocol.authentication_token = owner.uaclient.protocol.authentication_token
                thief._server_nonce, thief._policy_ids = owner._server_nonce, owner._policy_ids
                with pytest.raises(ua.UaStatusCodeError, match="BadSessionIdInvalid"):
                    await thief.activate_session(username="otto", password="wrong")
                with pytest.raises(ua.UaStatusCodeError):
                    await find(thief, VOLUME).read_value()
            finally:
                thief.disconnect_socket()
            assert await find(owner, VOLUME).read_value() == 0.0

    call(work)


def test_a_removed_user_loses_the_session(running: Running, trusted, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beltscape.protocols.opcua.server._USERS_S", 0.1)
    running.plant.users.roles["gone"] = "operator"

    async def work() -> None:
        client = await running.make_client(trusted, "gone")
        await client.connect()
        assert await find(client, VOLUME).read_value() == 0.0
        del running.plant.users.roles["gone"]
        with pytest.raises((ua.UaStatusCodeError, ConnectionError)):
            for _ in range(100):
                await asyncio.sleep(0.05)
                await find(client, VOLUME).read_value()
        client.disconnect_socket()

    call(work)


def make_garbage(rng: random.Random) -> bytes:
    """Return bytes of several kinds: noise, broken messages, announcements of far too much."""
    kind = rng.choice(("noise", "hello", "huge", "cut", "type"))
    if kind == "noise":
        return rng.randbytes(rng.randint(1, 3000))
    hello = b"HELF" + struct.pack("<IIIIIII", 32 + 20, 0, 65535, 65535, 0, 0, 20) + b"opc.tcp://127.0.0.1/"
    if kind == "hello":
        return hello + b"OPNF" + struct.pack("<I", rng.randint(8, 4000)) + rng.randbytes(rng.randint(0, 4000))
    if kind == "huge":
        return b"MSGF" + struct.pack("<I", rng.randint(2**20, 2**32 - 1)) + rng.randbytes(200_000)
    if kind == "cut":
        return hello[: rng.randint(1, len(hello))]
    return rng.randbytes(3) + b"F" + struct.pack("<I", 40) + rng.randbytes(32)


def test_garbage_stops_nothing(running: Running, trusted) -> None:
    rng = random.Random(11)
    port = running.server.port
    for turn in range(80):
        with socket.create_connection(("127.0.0.1", port)) as fuzz:
            try:
                fuzz.sendall(make_garbage(rng))
                if turn % 4 == 0:  # a reset in place of an end
                    fuzz.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
            except OSError:
                pass  # the server closed it: too much
    assert read_volume(running, trusted, "vera") == 0.0


def test_an_announced_flood_is_cut_off(running: Running) -> None:
    with socket.create_connection(("127.0.0.1", running.server.port)) as fuzz:
        fuzz.sendall(b"HELF" + struct.pack("<I", 2**31))
        with pytest.raises(OSError):
            for _ in range(1000):
                fuzz.sendall(bytes(100_000))


def test_many_sessions_read_and_some_are_killed(running: Running, trusted) -> None:
    count = 20 if THOROUGH else 6

    async def work() -> None:
        await wait_for(lambda: running.server.sessions == 0)
        clients = [await running.make_client(trusted, "vera") for _ in range(count)]
        await asyncio.gather(*(client.connect() for client in clients))
        values = await asyncio.gather(*(find(client, VOLUME).read_value() for client in clients))
        assert values == [0.0] * count
        assert running.server.sessions == count
        for client in clients[::2]:  # as if the program had been killed
            await (await client.create_subscription(100, None)).subscribe_data_change(find(client, VOLUME))
            client.uaclient.protocol.transport.abort()
        await wait_for(lambda: running.server.sessions == count // 2)
        rest = clients[1::2]
        values = await asyncio.gather(*(find(client, VOLUME).read_value() for client in rest))
        assert values == [0.0] * (count // 2)
        for client in rest:
            await client.disconnect()
        for client in clients[::2]:
            client.disconnect_socket()

    call(work)


def test_a_port_in_use_and_wrong_files_are_named(tmp_path: Path, trusted, folder: Path) -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        server = OpcUaServer(OpcUaSettings(port=other.getsockname()[1]), CommandedPlant(), tmp_path)
        with pytest.raises(InputError, match=r"\[opcua\]: 127.0.0.1 port \d+ cannot be listened on"):
            server.start()
    stranger = make_certificate(folder, "stranger2")
    with pytest.raises(InputError, match="is not the RSA key of"):
        open_own_certificate(OpcUaSettings(certificate=trusted[0], key=stranger[1]), tmp_path)
    with pytest.raises(InputError, match=r"none.der: no certificate, PEM or DER"):
        open_own_certificate(OpcUaSettings(certificate=tmp_path / "none.der", key=trusted[1]), tmp_path)
    own = open_own_certificate(OpcUaSettings(certificate=trusted[0], key=trusted[1]), tmp_path)
    assert own.application == APPLICATION


def test_the_private_key_is_private(running: Running) -> None:
    assert (running.data / "opcua/key.pem").stat().st_mode & 0o077 == 0


def test_a_restart_keeps_certificate_port_and_trust_and_takes_other_security(
    running: Running, trusted
) -> None:
    port, certificate = running.server.port, running.server.own.describe()
    began = time.monotonic()
    running.server.close()
    assert time.monotonic() - began < 5
    two = Running(running.data, security="encrypt", port=port)
    try:
        assert two.server.own.describe() == certificate
        assert read_volume(two, trusted, "vera") == 0.0
        with pytest.raises(ua.UaError):
            read_volume(two, trusted, "vera", mode=SIGN)

        async def list_modes() -> set[str]:
            endpoints = await Client(two.address).connect_and_get_server_endpoints()
            return {endpoint.SecurityMode.name for endpoint in endpoints}

        assert call(list_modes) == {"SignAndEncrypt"}
    finally:
        two.server.close()
