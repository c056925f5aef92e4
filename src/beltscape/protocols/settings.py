"""Settings of the protocols: the tables [modbus], [mqtt], [opcua], [outputs] and [syslog] of project.toml.

They load without the libraries of the protocols.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from beltscape.core.alarms import Priority
from beltscape.core.quantities import require_host

Limit = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]


class CommandSettings(BaseModel):
    """Registers that a control system writes: the table [modbus.commands].

    Modbus has no sign-in: with this table every client that reaches the port may change product and batch.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    first: Annotated[int, Field(ge=0, le=65_000)] = 1000
    """Address of the first register."""
    heartbeat_s: Annotated[float, Field(ge=0.5, le=3600)] = 10.0
    """Time within which the client's heartbeat must have changed for a command to be carried out."""


class ModbusSettings(BaseModel):
    """Address to listen on, form of the registers, and scales of the outputs."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)] = "127.0.0.1"
    """Address to listen on; "0.0.0.0" is reached from everywhere. Modbus has neither sign-in nor encryption."""
    port: Annotated[int, Field(ge=0, le=65_535)] = 502
    """TCP port; below 1024 the service needs the right to open it. 0: any free one."""
    unit: Annotated[int, Field(ge=0, le=247)] = 1
    """Unit identifier that is answered; 0 answers all."""
    words: Literal["big", "little"] = "big"
    """Order of the 16-bit words of a longer value: the most or the least significant first."""
    first: Annotated[int, Field(ge=0, le=60_000)] = 0
    """Address of the first register of the map."""
    addresses: dict[str, Annotated[int, Field(ge=0, le=65_535)]] = {}
    """Addresses by name, for control systems that expect others; with it only the named registers are served."""
    pulse_kg: Limit | None = None
    """Mass of one pulse of the pulse count; it needs a density."""
    pulse_l: Limit | None = None
    """Volume of one pulse, in place of ``pulse_kg``."""
    full_t_h: Limit | None = None
    """Mass flow at the end of the analogue scale, 20 mA."""
    full_m3_h: Limit | None = None
    """Volume flow at the end of the analogue scale, in place of ``full_t_h``."""
    commands: CommandSettings | None = None
    """Commands; without the table nothing can be written."""

    @model_validator(mode="after")
    def _check_one_of_two(self) -> ModbusSettings:
        for first, second in (("pulse_kg", "pulse_l"), ("full_t_h", "full_m3_h")):
            values = getattr(self, first), getattr(self, second)
            if None not in values:
                raise ValueError(
                    f"{first} = {values[0]:g} and {second} = {values[1]:g}: there is one of the two, remove the other"
                )
        return self


_SparkplugName = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^+#/\x00]+$")]


class SparkplugSettings(BaseModel):
    """Names of Sparkplug B: the table [mqtt.sparkplug]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    group: _SparkplugName = "Beltscape"
    """Group of edge nodes, such as the plant."""
    node: _SparkplugName = "beltscape"
    """This edge node; give every machine its own."""
    device: _SparkplugName = "belt"
    """The belt as a device of the node."""
    primary_host: Annotated[str, Field(max_length=100, pattern=r"^[^+#/\x00]*$")] = ""
    """Host application for which records wait while it is offline; empty: there is none."""


class MqttSettings(BaseModel):
    """Broker, topics and what is published."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """Name or address of the broker."""
    port: Annotated[int, Field(ge=1, le=65_535)] | None = None
    """TCP port; None: 8883 with TLS, else 1883."""
    payload: Literal["json", "sparkplug"] = "json"
    """Form of the messages: JSON below ``topic``, or Sparkplug B below spBv1.0."""
    sparkplug: SparkplugSettings = SparkplugSettings()
    topic: Annotated[str, Field(min_length=1, max_length=200)] = "beltscape/belt"
    """First part of all topics; give every belt its own."""
    client: Annotated[str, Field(min_length=1, max_length=60)] | None = None
    """Client identifier; None: from the topic. Two clients with one identifier disconnect each other."""
    user: Annotated[str, Field(max_length=200)] = ""
    """User name; empty: none."""
    password_file: Path | None = None
    """File whose first line is the password, readable by the service alone."""
    tls: bool = False
    """Whether to connect by TLS; the broker's certificate is checked against the system's authorities."""
    tls_ca: Path | None = None
    """PEM file with the broker's authority; with it ``tls`` is on."""
    tls_certificate: Path | None = None
    """PEM file with this client's certificate, where the broker asks for one; together with tls_key."""
    tls_key: Path | None = None
    """PEM file with its private key."""
    state_every_s: Annotated[float, Field(ge=0.2, le=3600)] = 1.0
    """Period of the present state."""
    first: Literal["new", "all"] = "new"
    """Records to publish at the first start: those from then on, or the whole ledger."""

    @field_validator("topic")
    @classmethod
    def _check_topic(cls, topic: str) -> str:
        if set(topic) & set("+#\0") or topic.startswith(("/", "$")) or topic.endswith("/"):
            raise ValueError(f"topic = {topic!r}: must not hold + or #, begin with / or $, or end with /")
        return topic

    @model_validator(mode="after")
    def _check_certificate(self) -> MqttSettings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise ValueError(f"{missing} is missing: a client's certificate needs both")
        return self

    @property
    def is_encrypted(self) -> bool:
        """Return whether the connection uses TLS."""
        return self.tls or self.tls_ca is not None

    @property
    def broker_port(self) -> int:
        """Return the TCP port."""
        return self.port or (8883 if self.is_encrypted else 1883)

    @property
    def client_id(self) -> str:
        """Return the client identifier."""
        return self.client or self.place.replace("/", "-")

    @property
    def place(self) -> str:
        """Return the part of the topics that is this belt's own."""
        own = self.sparkplug
        return self.topic if self.payload == "json" else f"spBv1.0/{own.group}/{own.node}/{own.device}"


Text = Annotated[str, Field(max_length=200)]


class OpcUaSettings(BaseModel):
    """Address to listen on, security, and what identifies the belt."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)] = "127.0.0.1"
    """Address to listen on; "0.0.0.0" is reached from everywhere."""
    port: Annotated[int, Field(ge=0, le=65_535)] = 4840
    """TCP port. 0: any free one."""
    name: Annotated[str, Field(min_length=1, max_length=60)] = "Belt"
    """Name of the belt among the machines; give every belt its own."""
    security: Literal["encrypt", "sign", "none"] = "sign"
    """Least security of a connection: signed and encrypted, signed, or none at all."""
    clients: Literal["trusted", "any"] = "trusted"
    """Certificates of clients that are accepted: those in the folder of trusted ones, or every valid one."""
    anonymous_role: Literal["viewer"] | None = None
    """Role without sign-in; None: users sign in."""
    certificate: Path | None = None
    """The server's own certificate, PEM or DER, together with ``key``; None: the service makes one."""
    key: Path | None = None
    """Its private key, PEM or DER."""
    hosts: tuple[Annotated[str, Field(pattern=r"^[A-Za-z0-9.:_-]{1,253}$")], ...] = ()
    """Further names and addresses by which clients connect, for the certificate that the service makes."""
    update_every_s: Annotated[float, Field(ge=0.1, le=60)] = 1.0
    """Period of the present values."""
    full_t_h: Limit | None = None
    """Mass flow of the full belt, the end of the flow's range; None: 100,000 t/h."""
    asset_id: Text = ""
    """The plant's own identification of the belt."""
    serial_number: Text = ""
    """Serial number of the measuring system."""
    location: Text = ""
    """Where the belt is."""

    @model_validator(mode="after")
    def _check_certificate(self) -> OpcUaSettings:
        if (self.certificate is None) != (self.key is None):
            missing = "key" if self.key is None else "certificate"
            raise ValueError(f"{missing} is missing: an own certificate needs both")
        return self


RegisterAddress = Annotated[int, Field(ge=0, le=65_535)]
PulseAmount = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
OutputQuantity = Literal["flow_t_h", "flow_m3_h", "load_m2", "speed_m_s", "coverage"]


class _OutputTable(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PulseSettings(_OutputTable):
    """One pulse per mass or volume: the table [outputs.pulse]."""

    kg: PulseAmount | None = None
    """Mass of a pulse; it needs a density."""
    l: PulseAmount | None = None  # noqa: E741
    """Volume of a pulse in litres, where ``kg`` is not given."""
    kind: Literal["coil", "counter"] = "coil"
    """A coil that is switched on and off for every pulse, or two holding registers with the count, modulo 2³²."""
    address: RegisterAddress
    """Of the coil, or of the counter's first register (the more significant word)."""
    on_ms: Annotated[int, Field(ge=5, le=10_000)] = 50
    """Time for which the coil is on."""
    off_ms: Annotated[int, Field(ge=5, le=10_000)] = 50
    """Least time for which it is off between two pulses."""

    @model_validator(mode="after")
    def _check_amount(self) -> PulseSettings:
        if (self.kg is None) == (self.l is None):
            raise ValueError("pulse: give either kg or l, the mass or the volume of a pulse")
        return self


class AnalogueSettings(_OutputTable):
    """A current of 4 to 20 mA: an entry of [[outputs.analogue]]."""

    value: OutputQuantity
    address: RegisterAddress
    """Holding register of the output."""
    zero: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] = 0.0
    """Value at 4 mA."""
    full: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
    """Value at 20 mA."""
    register_4_ma: RegisterAddress = 4000
    """What the module takes for 4 mA; the default is µA."""
    register_20_ma: RegisterAddress = 20_000
    """What the module takes for 20 mA."""
    failure: Literal["low", "high"] = "low"
    """Current while the value is not known: 3.5 mA or 21.5 mA (NAMUR NE 43)."""

    @model_validator(mode="after")
    def _check_scale(self) -> AnalogueSettings:
        if self.full == self.zero:
            raise ValueError(
                f"analogue: zero = full = {self.full:g}; they are the values at 4 mA and at 20 mA"
            )
        if self.register_4_ma >= self.register_20_ma:
            raise ValueError("analogue: register_4_ma must be below register_20_ma")
        extremes = (self.convert(3.5), self.convert(21.5))
        if extremes[0] < 0 or extremes[1] > 65_535:
            raise ValueError(
                "analogue: 3.5 mA and 21.5 mA do not fit into the register; choose register_4_ma higher"
            )
        return self

    def convert(self, current_ma: float) -> int:
        """Return what the register holds for a current."""
        span = self.register_20_ma - self.register_4_ma
        return round(self.register_4_ma + span * (current_ma - 4.0) / 16.0)


class OutputSettings(_OutputTable):
    """The I/O module, its pulse output and its analogue outputs."""

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """Name or address of the module."""
    port: Annotated[int, Field(ge=1, le=65_535)] = 502
    """TCP port."""
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    """Unit identifier of the module."""
    every_s: Annotated[float, Field(ge=0.05, le=60)] = 0.2
    """Period of the analogue outputs and of the search for new pulses."""
    heartbeat: RegisterAddress | None = None
    """Holding register that counts up with every period, for a watchdog in the module."""
    pulse: PulseSettings | None = None
    analogue: Annotated[tuple[AnalogueSettings, ...], Field(max_length=16)] = ()

    @model_validator(mode="after")
    def _check_addresses(self) -> OutputSettings:
        taken = [output.address for output in self.analogue]
        taken += [] if self.heartbeat is None else [self.heartbeat]
        if self.pulse is not None and self.pulse.kind == "counter":
            taken += [self.pulse.address, self.pulse.address + 1]
        if twice := next((address for address in taken if taken.count(address) > 1), None):
            raise ValueError(f"two outputs have the register {twice}")
        if not taken and self.pulse is None:
            raise ValueError("no output: give [outputs.pulse], [[outputs.analogue]] or both")
        return self


SyslogTransport = Literal["udp", "tcp", "tls"]
SYSLOG_PORTS: dict[SyslogTransport, int] = {"udp": 514, "tcp": 514, "tls": 6514}
"""Usual ports: RFC 5426, rsyslog's and syslog-ng's choice for RFC 6587, RFC 5425."""
SyslogName = Annotated[str, Field(min_length=1, max_length=48, pattern=r"^[!-~]+$")]
"""A name in a syslog header: printable ASCII without spaces, at most 48 characters (RFC 5424, 6)."""


class SyslogSettings(BaseModel):
    """Server and form of the messages."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """Name or address of the server."""
    transport: SyslogTransport = "udp"
    """"udp", "tcp" or "tls". By UDP messages are lost without notice while the server is away."""
    port: Annotated[int, Field(ge=1, le=65_535)] | None = None
    """None: 6514 for TLS, else 514."""
    tls_ca: Path | None = None
    """PEM file with the server's authority; None: the system's authorities."""
    tls_certificate: Path | None = None
    """PEM file with this client's certificate, where the server asks for one; together with tls_key."""
    tls_key: Path | None = None
    """PEM file with its private key."""
    facility: Annotated[int, Field(ge=0, le=23)] = 16
    """Facility (RFC 5424, table 1): 16 is local0."""
    hostname: Annotated[str, Field(max_length=255, pattern=r"^[!-~]*$")] = ""
    """Name of this machine in the messages; empty: its own."""
    app_name: SyslogName = "beltscape"
    """Name of the program in the messages; give every belt its own."""
    enterprise: Annotated[int, Field(ge=1, le=2**32 - 1)] = 32473
    """Private enterprise number of the structured data; 32473 is that of examples (RFC 5612)."""
    least: Priority = "low"
    """Alarms below this priority are not sent."""
    queue: Annotated[int, Field(ge=1, le=1_000_000)] = 1000
    """Messages that wait while the server is away; beyond it the oldest are dropped and counted."""

    @model_validator(mode="after")
    def _check_tls(self) -> SyslogSettings:
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise ValueError(f"{missing} is missing: a client's certificate needs both")
        if self.transport != "tls" and (self.tls_ca or self.tls_certificate):
            raise ValueError(
                f'transport = {self.transport!r} does not use tls_ca and tls_certificate; give "tls"'
            )
        return self

    @property
    def server_port(self) -> int:
        """Return the port of the server."""
        return self.port or SYSLOG_PORTS[self.transport]
