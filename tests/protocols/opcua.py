"""A served plant, its users, and clients with certificates, for the tests of OPC UA."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Callable, Coroutine, Mapping
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, TypeVar

from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import NameOID

from beltscape.core.errors import InputError
from beltscape.protocols.opcua.server import OpcUaServer
from beltscape.protocols.plant import UserRole
from beltscape.protocols.settings import OpcUaSettings
from tests.protocols.plant import FakePlant

APPLICATION = "urn:test:client"
PASSWORD = "four seasons of ore"
ROLES: tuple[UserRole, ...] = ("viewer", "operator", "engineer")
Result = TypeVar("Result")
_CLOCK_NS = itertools.count(10**18 + 10**9, 10**9)


class FakeUsers:
    """Users in memory, and the audit log."""

    def __init__(self) -> None:
        self.roles: dict[str, UserRole] = {"vera": "viewer", "otto": "operator"}
        self.entries: list[tuple[str, str, str, Mapping[str, str]]] = []
        self.attempts: list[tuple[str, str]] = []

    def find_by_password(self, name: str, password: str, address: str) -> str | None:
        self.attempts.append((name, address))
        return name if name in self.roles and password == PASSWORD else None

    def has_role(self, user: str, role: UserRole) -> bool:
        return user in self.roles and ROLES.index(self.roles[user]) >= ROLES.index(role)

    def write_audit(self, action: str, user: str, address: str, detail: Mapping[str, str]) -> None:
        self.entries.append((action, user, address, detail))


class CommandedPlant(FakePlant):
    """A plant that keeps the commands it was given."""

    def __init__(self) -> None:
        super().__init__()
        self.users = FakeUsers()
        self.provenance = {"Program": "beltscape test", "RigSha256": "ab" * 32}
        self.commands: list[tuple[str, ...]] = []

    def acknowledge(self, alarm: str, user: str) -> None:
        self.commands.append(("acknowledge", alarm, user))

    def start_batch(self, name: str, product: str, user: str) -> None:
        self.commands.append(("start", name, product, user))

    def stop_batch(self, user: str) -> None:
        raise InputError("batch: there is none")

    def change_product(self, name: str, user: str) -> None:
        self.commands.append(("product", name, user))


def make_certificate(
    folder: Path, name: str, days: int = 30, application: str = APPLICATION, bits: int = 2048
) -> tuple[Path, Path]:
    """Return a client's self-signed certificate (DER) and its key; negative ``days``: it has expired."""
    key = rsa.generate_private_key(65537, bits)
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    uri = x509.SubjectAlternativeName(
        [x509.UniformResourceIdentifier(application), x509.DNSName("localhost")]
    )
    usage = x509.KeyUsage(True, True, True, True, False, False, False, False, False)
    certificate = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(now - timedelta(days=60))
        .not_valid_after(now + timedelta(days=days))
        .add_extension(uri, critical=False)
        .add_extension(usage, critical=False)
        .sign(key, hashes.SHA256())
    )
    paths = folder / f"{name}.der", folder / f"{name}.pem"
    paths[0].write_bytes(certificate.public_bytes(serialization.Encoding.DER))
    pem = serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    paths[1].write_bytes(key.private_bytes(*pem))
    return paths


class Running:
    """A server on a free port, with the plant it serves and its data folder."""

    def __init__(self, data: Path, plant: CommandedPlant | None = None, **settings: object) -> None:
        self.plant, self.data = plant or CommandedPlant(), data
        values = {"port": 0, "update_every_s": 0.1, **settings}
        self.messages: list[str] = []
        self.server = OpcUaServer(
            OpcUaSettings.model_validate(values), self.plant, data, self.messages.append
        )
        self.server.start()
        self.address = f"opc.tcp://127.0.0.1:{self.server.port}/"

    def trust(self, certificate: Path) -> None:
        """Put a client's certificate into the folder of the trusted ones."""
        (self.data / "opcua" / "trusted" / certificate.name).write_bytes(certificate.read_bytes())

    async def make_client(
        self,
        certificate: tuple[Path, Path] | None = None,
        user: str = "",
        password: str = PASSWORD,
        mode: ua.MessageSecurityMode = ua.MessageSecurityMode.SignAndEncrypt,
    ) -> Client:
        """Return a client that has not connected yet."""
        client = Client(self.address, timeout=10)
        client.application_uri = APPLICATION
        if user:
            client.set_user(user)
            client.set_password(password)
        if certificate is not None:
            policy = SecurityPolicyBasic256Sha256
            await client.set_security(policy, str(certificate[0]), str(certificate[1]), mode=mode)
        return client


def call(work: Callable[[], Coroutine[Any, Any, Result]]) -> Result:
    """Run a client's work in an event loop of its own."""
    return asyncio.run(asyncio.wait_for(work(), 60))


def find(client: Client, path: str) -> Any:
    """Return the node of a path below the belt."""
    return client.get_node(f"ns=2;s={path}")


async def wait_for(condition: Callable[[], bool], seconds: float = 10.0) -> None:
    """Wait for a condition; AssertionError if it does not become true."""
    for _ in range(int(seconds / 0.02)):
        if condition():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it did not happen in time")


async def read(client: Client, path: str) -> ua.DataValue:
    """Return a value with its status, good or bad."""
    return await find(client, path).read_data_value(raise_on_bad_status=False)


async def set_state(running: Running, client: Client, **changes: Any) -> None:
    """Change the plant's state and wait until it is shown."""
    running.plant.state = replace(running.plant.state, wall_ns=next(_CLOCK_NS), **changes)
    expected = running.plant.state.wall_ns // 1000
    for _ in range(500):
        value = await read(client, "Belt.Monitoring.Process.VolumeFlowRate")
        if round(value.SourceTimestamp.timestamp() * 1e6) == expected:
            return
        await asyncio.sleep(0.02)
    raise AssertionError("the state was not shown")
