"""Settings of access: sessions, requests and connections."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class AccessSettings(BaseModel):
    """[web.access]: users, sessions and request limits."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    anonymous_role: Literal["viewer"] | None = None
    """Role without login; None: login is required. "viewer" suits a wall display."""
    allowed_hosts: tuple[str, ...] = ()
    """Names by which browsers may call the service, beside IP addresses, localhost and the machine's own name."""
    session_idle_hours: float = Field(default=12, gt=0, le=24 * 30)
    """A session ends after this time without a request."""
    session_days: float = Field(default=7, gt=0, le=90)
    """A session ends this long after the login in any case."""
    requests_per_s: float = Field(default=50, gt=0, le=100_000)
    """Sustained request rate of one address, and of one user."""
    requests_burst: int = Field(default=300, ge=1, le=1_000_000)
    """Requests allowed at once."""
    body_max_bytes: int = Field(default=65_536, ge=1024, le=64 * 2**20)
    """Longest request body."""
    body_timeout_s: float = Field(default=10, gt=0, le=300)
    """A request's body must have arrived within this time."""
    sockets_max: int = Field(default=64, ge=1, le=4096)
    """WebSockets open at the same time."""
    sockets_per_address: int = Field(default=16, ge=1, le=4096)
    """WebSockets open at the same time from one address."""
    audit_file_mb: float = Field(default=10, gt=0, le=1000)
    """The audit log is rotated at this size."""
    audit_files: int = Field(default=10, ge=1, le=1000)
    """Number of rotated audit logs that are kept."""


class LimitSettings(BaseModel):
    """[web.limits]: limits of the listening socket."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    allow_plain_http: bool = False
    """Listen beyond this machine without TLS: passwords and figures can then be read on the way."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses of proxies whose X-Forwarded-For and X-Forwarded-Proto are trusted."""
    connections_max: int = Field(default=256, ge=8, le=65_536)
    """Connections open at the same time; further ones are closed at once."""
    connections_per_address: int = Field(default=64, ge=1, le=65_536)
    """Connections open at the same time from one address."""
    reads_per_s: float = Field(default=400, gt=0, le=1e6)
    """Reads of 4 KiB from all connections; faster senders wait, so that the measurement is not slowed."""
    reads_per_s_per_address: float = Field(default=150, gt=0, le=1e6)
    """Reads of 4 KiB from the connections of one address."""
    header_max_bytes: int = Field(default=16_384, ge=4096, le=262_144)
    """Longest request line and headers together."""
    socket_max_bytes: int = Field(default=65_536, ge=1024, le=16 * 2**20)
    """Longest message a page may send over its WebSocket."""
    header_timeout_s: float = Field(default=10, gt=0, le=300)
    """A TLS handshake, and a request's headers, must have arrived within this time."""
    write_timeout_s: float = Field(default=20, gt=0, le=600)
    """A client that reads nothing for this time is disconnected."""
    keep_alive_s: int = Field(default=15, ge=1, le=600)
    """An idle connection is closed after this time."""
