"""The check of each protocol before it is served, and the library that it needs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from importlib import import_module
from typing import Any

from beltscape.core.errors import InputError, describe_missing_library
from beltscape.protocols.settings import (
    ModbusSettings,
    MqttSettings,
    OpcUaSettings,
    OutputSettings,
    SyslogSettings,
)


@contextmanager
def name_library(table: str) -> Generator[None]:
    """Turn the absence of a library into an InputError that names the table and the line to type."""
    try:
        yield
    except ImportError as error:
        raise InputError(f"[{table}]: {describe_missing_library(error) or error}") from error


def check_mqtt(mqtt: MqttSettings) -> str:
    """Return what would be published; InputError where it cannot be."""
    with name_library("mqtt"):
        from beltscape.protocols.mqtt.publisher import check_settings
    check_settings(mqtt)
    secured = "TLS" if mqtt.is_encrypted else "without TLS"
    return f"{mqtt.host} port {mqtt.broker_port}, {secured}, topic {mqtt.place}"


def check_modbus(modbus: ModbusSettings) -> str:
    """Return what would be served; InputError where it cannot be."""
    from beltscape.protocols.modbus import place_commands
    from beltscape.protocols.modbus_registers import place_registers

    registers = place_registers(modbus)
    place_commands(modbus, registers)
    last = registers[-1].address + registers[-1].words - 1
    return f"{modbus.host} port {modbus.port}, registers {registers[0].address} to {last}"


def check_opcua(opcua: OpcUaSettings) -> str:
    """Return what would be served; InputError where it cannot be."""
    with name_library("opcua"):
        from beltscape.protocols.opcua.certificates import read_certificate
    given = read_certificate(opcua)
    own = "a certificate of its own" if given is None else given.describe()
    return f"{opcua.host} port {opcua.port}, least security {opcua.security}, {own}"


def check_syslog(syslog: SyslogSettings) -> str:
    """Return where alarms would go; InputError where they cannot."""
    from beltscape.protocols.syslog import check_settings

    return check_settings(syslog)


def check_outputs(outputs: OutputSettings) -> str:
    """Return what would be written; InputError where it cannot be."""
    with name_library("outputs"):
        import_module("pymodbus")
    pulse = "no pulses" if outputs.pulse is None else f"pulses as a {outputs.pulse.kind}"
    return f"{outputs.host} port {outputs.port}, {pulse}, {len(outputs.analogue)} currents"


def find_mqtt_fault(mqtt: MqttSettings) -> str:
    """Return why the broker does not accept a connection now; empty if it does."""
    from beltscape.protocols.mqtt.connection import find_refusal
    from beltscape.protocols.mqtt.publisher import read_password

    trouble = find_refusal(mqtt, read_password(mqtt.password_file))
    return f"{mqtt.host} port {mqtt.broker_port}: {trouble}" if trouble else ""


def find_syslog_fault(syslog: SyslogSettings) -> str:
    """Return why the server cannot be connected now; empty if it can. By UDP only its address is looked up."""
    from beltscape.protocols.syslog import SyslogConnection

    try:
        SyslogConnection(syslog).close()
    except OSError as error:
        return f"{syslog.host} port {syslog.server_port}: {error.strerror or error}"
    return ""


CHECKS: Mapping[str, Callable[[Any], str]] = {
    "mqtt": check_mqtt,
    "modbus": check_modbus,
    "opcua": check_opcua,
    "syslog": check_syslog,
    "outputs": check_outputs,
}
"""By the name of its table: returns one line about a protocol; InputError where it cannot be served."""
REACHES: Mapping[str, Callable[[Any], str]] = {"mqtt": find_mqtt_fault, "syslog": find_syslog_fault}
"""By the name of its table: returns why the other machine cannot be reached now, in one line; empty if it can."""
