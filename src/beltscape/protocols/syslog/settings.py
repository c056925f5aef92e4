"""Settings of the table [syslog] of project.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.live.alarms import Priority
from beltscape.core.plausibility import require_host

Transport = Literal["udp", "tcp", "tls"]
PORTS: dict[Transport, int] = {"udp": 514, "tcp": 514, "tls": 6514}
"""Usual ports: RFC 5426, rsyslog's and syslog-ng's choice for RFC 6587, RFC 5425."""
Name = Annotated[str, Field(min_length=1, max_length=48, pattern=r"^[!-~]+$")]
"""A name in a syslog header: printable ASCII without spaces, at most 48 characters (RFC 5424, 6)."""


class SyslogSettings(BaseModel):
    """Server and form of the messages."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """Name or address of the server."""
    transport: Transport = "udp"
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
    app_name: Name = "beltscape"
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
        return self.port or PORTS[self.transport]
