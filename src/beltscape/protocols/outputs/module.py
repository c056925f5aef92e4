"""The connection to the I/O module."""

from __future__ import annotations

import logging
from typing import Any

from pymodbus.client import ModbusTcpClient
from pymodbus.exceptions import ModbusException

from beltscape.protocols.outputs.settings import OutputSettings

_TIMEOUT_S = 1.0
"""Time for an answer; a module of a plant's network answers within some ms."""


class ModuleAwayError(Exception):
    """The module does not answer, or refuses a request."""


class OutputModule:
    """Writes to the module and reads back; every method raises ModuleAwayError where that fails."""

    def __init__(self, settings: OutputSettings) -> None:
        self._settings = settings
        self._client: Any = None
        logging.getLogger("pymodbus").setLevel(logging.CRITICAL)  # it would log every failure to connect

    def write_coil(self, address: int, *, is_on: bool) -> None:
        """Switch a coil; done again it changes nothing."""
        self._ask("write_coil", address, is_on)

    def read_coil(self, address: int) -> bool:
        """Return whether a coil is on."""
        return bool(self._ask("read_coils", address, count=1).bits[0])

    def write_registers(self, address: int, words: list[int]) -> None:
        """Write holding registers in one request."""
        self._ask("write_registers", address, words)

    def close(self) -> None:
        """Close the connection; the next request opens a new one."""
        if self._client is not None:
            self._client.close()
            self._client = None

    def _ask(self, request: str, address: int, *values: Any, **more: Any) -> Any:
        """Return the answer to a request."""
        place = f"{self._settings.host} port {self._settings.port}"
        try:
            if self._client is None:
                client: Any = ModbusTcpClient(
                    self._settings.host, port=self._settings.port, timeout=_TIMEOUT_S, retries=0
                )
                if not client.connect():
                    raise ModuleAwayError(f"{place}: cannot be connected")
                self._client = client
            answer = getattr(self._client, request)(address, *values, device_id=self._settings.unit, **more)
        except (ModbusException, OSError) as error:
            self.close()
            raise ModuleAwayError(f"{place}: {' '.join(str(error).split())}") from error
        if answer.isError():
            raise ModuleAwayError(f"{place}: refuses {request} at address {address} ({answer})")
        return answer
