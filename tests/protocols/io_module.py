"""An I/O module for the tests: a pymodbus server that holds coils and registers, and counts what a counter would."""

from __future__ import annotations

import asyncio
import random
import threading
from typing import Any

from pymodbus.constants import ExcCodes
from pymodbus.server import ModbusTcpServer
from pymodbus.simulator import DataType, SimData, SimDevice

from tests.protocols.broker import find_port

COIL, COUNTER = 3, 20


class IoModule:
    """Its state outlives its connections: a stopped one answers nobody, and holds its outputs."""

    def __init__(self, seed: int = 1) -> None:
        self.port = find_port()
        self.coil = False
        self.edges = 0
        self.registers: dict[int, int] = {}
        self.counts: list[int] = []
        self.lost_answers = 0.0
        self._rng = random.Random(seed)
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._failure = ""

    def start(self) -> None:
        """Answer requests."""
        self._stop.clear()
        ready = threading.Event()
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve(ready)))
        self._thread.start()
        assert ready.wait(10), self._failure

    def stop(self) -> None:
        """Answer nobody any more."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join(10)

    async def _serve(self, ready: threading.Event) -> None:
        server = ModbusTcpServer(self._make_device(), address=("127.0.0.1", self.port))
        await server.serve_forever(background=True)
        ready.set()
        while not self._stop.is_set():
            await asyncio.sleep(0.005)
        await server.shutdown()

    def _make_device(self) -> SimDevice:
        coils = [SimData(0, values=[False] * COIL + [self.coil] + [False] * 12, datatype=DataType.BITS)]
        registers = [SimData(0, count=64, datatype=DataType.REGISTERS)]

        async def act(
            function: int, _start: int, address: int, count: int, words: list[Any], values: Any
        ) -> ExcCodes | None:
            if function == 5 and values is not None:
                self._switch(is_on=bool(values[0]))
            elif function == 16 and values is not None:
                self.registers.update({address + i: int(word) for i, word in enumerate(values)})
                if address == COUNTER:
                    self.counts.append((values[0] << 16) + values[1])
            if self._rng.random() < self.lost_answers:
                await asyncio.sleep(0.3)  # longer than the client waits
            return None

        return SimDevice(1, (coils, coils, registers, registers), action=act)

    def _switch(self, *, is_on: bool) -> None:
        self.edges += is_on and not self.coil
        self.coil = is_on
