"""Hostile bytes on every port of a service while records are written: mutated and invented frames, by a seed.

The short form is a test; for minutes of it: ``python -m tests.service.port_fuzz 3``.
"""

from __future__ import annotations

import random
import socket
import struct
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Mapping
from contextlib import ExitStack, closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from beltscape.protocols.settings import ModbusSettings, OpcUaSettings
from beltscape.service.access import Access, AccessSettings
from beltscape.service.app import create_app
from beltscape.service.hosting import serve
from beltscape.service.live_state import LiveState
from beltscape.service.protocols import ProtocolSettings, ServedPlant, serve_protocols
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian
from beltscape.sinks.settings import HistorySettings
from tests.protocols.broker import find_port
from tests.service.access.sample_app import CHEAP
from tests.service.feeder import SimulatedPlant
from tests.sinks.ledgers import ledger

RECORDS = 20
"""Records before the attack."""
_ENDPOINT = b"opc.tcp://127.0.0.1/"
SAMPLES: Mapping[str, tuple[bytes, ...]] = {
    "http": (
        b"GET /login HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n",
        b"POST /api/access/login HTTP/1.1\r\nHost: 127.0.0.1\r\nContent-Type: application/json\r\n"
        b"Content-Length: 30\r\n\r\n" + b'{"name":"anna","password":"x"}',
        b"GET /api/live HTTP/1.1\r\nHost: 127.0.0.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        b"Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n",
    ),
    "modbus": (
        bytes.fromhex("000100000006010300000004"),
        bytes.fromhex("000200000006010400000002"),
        bytes.fromhex("00030000000601060010ffff"),
        bytes.fromhex("00040000000b0110000000020400010002"),
        bytes.fromhex("0005000000020111"),
        bytes.fromhex("000600000005012b0e0100"),
    ),
    "opcua": (
        b"HELF" + struct.pack("<IIIIIII", 32 + len(_ENDPOINT), 0, 65535, 65535, 0, 0, len(_ENDPOINT)) + _ENDPOINT,
        b"OPNF" + struct.pack("<II", 132, 0) + struct.pack("<I", 47)
        + b"http://opcfoundation.org/UA/SecurityPolicy#None" + b"\xff" * 8 + struct.pack("<II", 1, 1)
        + bytes.fromhex("0100be01") + b"\0" * 49,
        b"MSGF" + struct.pack("<IIIII", 64, 1, 1, 2, 2) + bytes.fromhex("0100cf01") + b"\0" * 36,
        b"CLOF" + struct.pack("<II", 12, 1),
    ),
}  # fmt: skip
"""By protocol: valid messages, from which the hostile ones are made."""


@dataclass(frozen=True)
class Service:
    """A service under attack."""

    ports: Mapping[str, int]
    historian: Historian
    plant: SimulatedPlant


@contextmanager
def run_service(folder: Path) -> Generator[Service]:
    """Serve page, Modbus and OPC UA of one history."""
    web = WebSettings(port=0, access=AccessSettings(requests_per_s=1e5, requests_burst=10**6))
    ports = {"modbus": find_port(), "opcua": find_port()}
    settings = ProtocolSettings(
        modbus=ModbusSettings(port=ports["modbus"]), opcua=OpcUaSettings(port=ports["opcua"])
    )
    with ExitStack() as opened:
        live_state, historian = LiveState(web), Historian(folder, HistorySettings(reserve_mib=1))
        opened.callback(historian.close)
        historian.begin_run()
        access = opened.enter_context(closing(Access(folder, web.access, CHEAP)))
        plant = SimulatedPlant([live_state], historian)
        served = ServedPlant(live_state, historian, plant.acknowledge)
        opened.enter_context(serve_protocols(settings, served, folder, lambda _: None))
        page = opened.enter_context(
            closing(serve(create_app(live_state, historian, access, plant, web), web))
        )
        ports["http"] = int(page.address.rsplit(":", 1)[1])
        historian.write(ledger(RECORDS, sections=False))
        plant.number, plant.belt_mm = RECORDS, historian.ledger_end.end_mm or 0.0
        yield Service(ports, historian, plant)


def mutate(sample: bytes, chance: random.Random) -> bytes:
    """Return a message that is damaged in one of several ways, or invented."""
    data = bytearray(sample)
    match chance.randrange(7):
        case 0:
            return chance.randbytes(chance.randrange(1, 400))
        case 1:
            return bytes(data[: chance.randrange(len(data))])
        case 2:
            for _ in range(chance.randrange(1, 8)):
                data[chance.randrange(len(data))] = chance.randrange(256)
        case 3:
            place = chance.randrange(len(data))
            data[place:place] = chance.randbytes(chance.randrange(1, 64))
        case 4:  # a length that lies
            place = chance.randrange(max(1, len(data) - 4))
            data[place : place + 4] = chance.choice((b"\xff\xff\xff\xff", b"\0\0\0\0", b"\xff\xff\xff\x7f"))
        case 5:
            return bytes(data) * chance.randrange(2, 20)
        case _:
            del data[chance.randrange(len(data))]
    return bytes(data)


def send(port: int, messages: list[bytes]) -> None:
    """Send messages over one connection, and read what may come."""
    with suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=0.5) as connection:
        connection.settimeout(0.02)
        for message in messages:
            connection.sendall(message)
            with suppress(TimeoutError):
                if not connection.recv(4096):
                    return


def attack(ports: Mapping[str, int], seed: int, connections: int) -> None:
    """Send hostile messages to every port, the same for the same seed."""
    chance = random.Random(seed)
    for _ in range(connections):
        name = chance.choice(sorted(SAMPLES))
        samples = SAMPLES[name]
        first = [samples[0]] if chance.random() < 0.5 else []
        messages = [mutate(chance.choice(samples), chance) for _ in range(chance.randrange(1, 4))]
        send(ports[name], first + messages)


def is_answering(name: str, port: int) -> bool:
    """Return whether a port still answers a valid message."""
    with socket.create_connection(("127.0.0.1", port), timeout=5) as connection:
        connection.sendall(SAMPLES[name][0])
        answer = connection.recv(4096)
    return answer.startswith({"http": b"HTTP/1.1 200", "modbus": b"\0\1", "opcua": b"ACK"}[name])


def list_threads() -> set[str]:
    """Return the names of the running threads of the service."""
    return {thread.name for thread in threading.enumerate() if thread.is_alive()}


def main(minutes: float) -> None:
    """Attack for some minutes, and print what was sent and lost."""
    with tempfile.TemporaryDirectory() as folder, run_service(Path(folder)) as service:
        before, seed = list_threads(), 0
        end = time.monotonic() + 60 * minutes
        while time.monotonic() < end:
            attack(service.ports, seed, 50)
            service.plant.step()
            seed += 1
        lost = before - list_threads()
        answering = {name: is_answering(name, port) for name, port in service.ports.items()}
        numbers = [one.number for one in service.historian.records(0, 1 << 62, 10**6)]
        print(f"{50 * seed} connections; threads lost: {sorted(lost) or 'none'}; answering: {answering}")
        print(f"records {len(numbers)}, without gap: {numbers == [*range(1, len(numbers) + 1)]}")


if __name__ == "__main__":
    main(float(sys.argv[1]) if len(sys.argv) > 1 else 3.0)
