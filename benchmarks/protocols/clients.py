"""Clients of the protocols for the benchmark of their load: each counts what it has read."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Generator, Iterable, Mapping
from contextlib import contextmanager, suppress
from importlib import import_module
from typing import Any

READ: dict[str, int] = dict.fromkeys(("web", "modbus", "mqtt", "sparkplug", "opcua", "outputs"), 0)
"""By protocol: what its client has read; a benchmark without it measures nothing."""
ENDED: dict[str, str] = {}
"""By protocol: the error that ended its client."""
_RETRY_S = 0.2
"""Wait before a client that was refused tries again: without it, one that begins before its server takes thousands of
ports a second, among them those that are still to be served."""


def read_modbus(port: int, ended: threading.Event) -> None:
    """Read all registers ten times a second."""
    from pymodbus.client import ModbusTcpClient

    client = ModbusTcpClient("127.0.0.1", port=port, retries=0, timeout=2)
    while not ended.is_set():
        with suppress(Exception):
            if client.connected or client.connect():
                answer = client.read_holding_registers(0, count=40, device_id=1)
                READ["modbus"] += not answer.isError()
        ended.wait(0.1)
    client.close()


def subscribe_opcua(port: int, ended: threading.Event) -> None:
    """Subscribe to every variable of the server."""
    asyncio.run(_subscribe(port, ended))


async def _subscribe(port: int, ended: threading.Event) -> None:
    from asyncua import Client, ua

    class Handler:
        def datachange_notification(self, *_: object) -> None:
            READ["opcua"] += 1

    client = Client(f"opc.tcp://127.0.0.1:{port}/")
    while not ended.is_set():
        with suppress(Exception):
            await client.connect()
            break
        await asyncio.sleep(_RETRY_S)
    subscription = await client.create_subscription(500, Handler())
    nodes, variables = [client.nodes.objects], []
    for node in nodes:
        for child in await node.get_children():
            if child.nodeid.NamespaceIndex == 0 or child in nodes:
                continue
            nodes.append(child)
            if await child.read_node_class() == ua.NodeClass.Variable:
                variables.append(child)
    await subscription.subscribe_data_change(variables)
    while not ended.is_set():
        await asyncio.sleep(0.2)
    with suppress(Exception):
        await client.disconnect()


def subscribe_mqtt(name: str, topic: str, port: int, ended: threading.Event) -> None:
    """Subscribe to everything that the plant publishes."""
    from paho.mqtt.client import Client
    from paho.mqtt.enums import CallbackAPIVersion

    def count(*_: object) -> None:
        READ[name] += 1

    def subscribe(*_: object) -> None:
        client.subscribe(topic, qos=1)

    client = Client(CallbackAPIVersion.VERSION2)
    client.on_connect, client.on_message = subscribe, count
    client.connect("127.0.0.1", port)
    client.loop_start()
    ended.wait()
    client.disconnect()
    client.loop_stop()


def run_module(port: int, ended: threading.Event) -> None:
    """Be the I/O module; count the pulses."""
    asyncio.run(_run_module(port, ended))


async def _run_module(port: int, ended: threading.Event) -> None:
    from pymodbus.server import ModbusTcpServer
    from pymodbus.simulator import DataType, SimData, SimDevice

    coils = [SimData(0, values=[False] * 16, datatype=DataType.BITS)]
    registers = [SimData(0, count=64, datatype=DataType.REGISTERS)]

    async def count(
        function: int, _start: int, _address: int, _count: int, _words: list[Any], values: Any
    ) -> None:
        if function == 5 and values is not None:  # write single coil
            READ["outputs"] += bool(values[0])

    device = SimDevice(1, (coils, coils, registers, registers), action=count)
    server = ModbusTcpServer(device, address=("127.0.0.1", port))
    await server.serve_forever(background=True)
    while not ended.is_set():
        await asyncio.sleep(0.05)
    await server.shutdown()


def follow_page(port: int, ended: threading.Event) -> None:
    """Take every message of the operator's page, as an open browser does."""
    from websockets.exceptions import WebSocketException
    from websockets.sync.client import connect

    while not ended.is_set():
        with suppress(WebSocketException, OSError), connect(f"ws://127.0.0.1:{port}/api/live") as page:
            while not ended.is_set():
                READ["web"] += len(page.recv(timeout=5)) > 0
        ended.wait(_RETRY_S)


CLIENTS = {
    "web": follow_page,
    "modbus": read_modbus,
    "mqtt": lambda port, ended: subscribe_mqtt("mqtt", "beltscape/#", port, ended),
    "sparkplug": lambda port, ended: subscribe_mqtt("sparkplug", "spBv1.0/#", port, ended),
    "opcua": subscribe_opcua,
    "outputs": run_module,
}
"""By protocol: what reads it in the process of the benchmark."""
_CLIENT_S = 10.0
"""Longest wait for the end of a client."""
_LIBRARIES = ("asyncua", "paho.mqtt.client", "pymodbus.client", "pymodbus.server", "websockets.sync.client")
"""What the clients import: before their threads begin, for two threads can see each other's half imported modules."""


def _follow(name: str, port: int, ended: threading.Event) -> None:
    """Let the client of a protocol read; keep the error that ends it."""
    try:
        CLIENTS[name](port, ended)
    except Exception as error:  # whatever it is, the benchmark states it
        ENDED[name] = f"{type(error).__name__}: {error}"


def describe_reading(names: Iterable[str]) -> str:
    """Return what the clients of these protocols have read, and the errors that ended them."""
    return ", ".join(
        f"{name} {READ[name]}" + (f" (ended by {ENDED[name]})" if name in ENDED else "")
        for name in names
        if name in READ
    )


@contextmanager
def read_all(ports: Mapping[str, int]) -> Generator[None]:
    """Let one client of each protocol, and an open page, read what is served at these ports."""
    for library in _LIBRARIES:
        import_module(library)
    ended = threading.Event()
    clients = [
        threading.Thread(target=_follow, args=(name, port, ended), daemon=True)
        for name, port in ports.items()
        if name in CLIENTS
    ]
    for client in clients:
        client.start()
    try:
        yield
    finally:
        ended.set()
        for client in clients:
            client.join(_CLIENT_S)
