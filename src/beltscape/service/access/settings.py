"""Who may come in and how: bounds of sessions, logins and requests."""

from __future__ import annotations

from typing import Literal

from pydantic import BaseModel, ConfigDict, Field


class AccessSettings(BaseModel):
    """[web.access]: users, sessions and what one address may ask for."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    anonymous_role: Literal["viewer"] | None = None
    """What somebody is who has not logged in; None: must log in. "viewer" suits a wall display."""
    allowed_hosts: tuple[str, ...] = ()
    """Names by which browsers may call the service, beside IP addresses, localhost and the machine's own name."""
    session_idle_hours: float = Field(12, gt=0, le=24 * 30)
    """A session ends when nothing was asked for so long."""
    session_days: float = Field(7, gt=0, le=90)
    """A session ends so long after the login in any case."""
    requests_per_s: float = Field(50, gt=0, le=100_000)
    """Requests one address, and one user, may make in the long run."""
    requests_burst: int = Field(300, ge=1, le=1_000_000)
    """Requests that may come at once."""
    body_max_bytes: int = Field(65_536, ge=1024, le=64 * 2**20)
    """Longest request body."""
    body_timeout_s: float = Field(10, gt=0, le=300)
    """A request's body must have arrived within this time."""
    sockets_max: int = Field(64, ge=1, le=4096)
    """WebSockets open at the same time."""
    sockets_per_address: int = Field(16, ge=1, le=4096)
    """Of those, from one address."""
    audit_file_mb: float = Field(10, gt=0, le=1000)
    """The audit log is set aside when it has grown so large."""
    audit_files: int = Field(10, ge=1, le=1000)
    """So many of those set aside are kept."""


class LimitSettings(BaseModel):
    """[web.limits]: what the listening socket puts up with."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    allow_plain_http: bool = False
    """Listen beyond this machine without TLS: passwords and figures can then be read on the way."""
    trusted_proxies: tuple[str, ...] = ()
    """Addresses of proxies whose X-Forwarded-For and X-Forwarded-Proto are believed."""
    connections_max: int = Field(256, ge=8, le=65_536)
    """Connections open at the same time; further ones are closed at once."""
    connections_per_address: int = Field(64, ge=1, le=65_536)
    """Of those, from one address."""
    reads_per_s: float = Field(400, gt=0, le=1e6)
    """Pieces of 4 KiB read from all connections; who sends more waits, so that the measuring keeps its time."""
    reads_per_s_per_address: float = Field(150, gt=0, le=1e6)
    """Of those, from one address."""
    header_max_bytes: int = Field(16_384, ge=4096, le=262_144)
    """Longest request line and headers together."""
    socket_max_bytes: int = Field(65_536, ge=1024, le=16 * 2**20)
    """Longest message a page may send over its WebSocket."""
    header_timeout_s: float = Field(10, gt=0, le=300)
    """A TLS handshake, and a request's headers, must have arrived within this time."""
    write_timeout_s: float = Field(20, gt=0, le=600)
    """A reader who takes nothing for so long is cut off."""
    keep_alive_s: int = Field(15, ge=1, le=600)
    """An idle connection is closed after this time."""
