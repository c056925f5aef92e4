"""Settings of the operator's page and its HTTP interface, [web] in project.toml, and the page's languages.

The tables below it are those of access (sessions, requests) and of connections. Each language is one file of texts in
``data/web/languages``, found by itself.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import require_host
from beltscape.core.translatable_message import LANGUAGES_FOLDER


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


DEFAULT_LANGUAGE = "en"
"""Code of the language that is the first of the list, and that every text is written in."""


@dataclass(frozen=True, slots=True)
class Language:
    """A language in which the page can be shown."""

    code: str
    """Name of its file, such as "de"."""
    name: str
    """Its name in itself."""
    locale: str
    """Locale of its numbers and times, such as "de-DE"."""
    tag: str
    """Language tag of the document (BCP 47), such as "zh-Hans"."""


def read_texts(code: str) -> dict[str, str]:
    """Return the texts of a language by their keys; OSError if it has no file."""
    return json.loads((LANGUAGES_FOLDER / f"{code}.json").read_text(encoding="utf-8"))


@cache
def list_languages() -> tuple[Language, ...]:
    """Return the languages that have a file: English, then the others in the order of their codes."""
    codes = sorted(
        (path.stem for path in LANGUAGES_FOLDER.glob("*.json")),
        key=lambda code: (code != DEFAULT_LANGUAGE, code),
    )
    return tuple(_read_language(code) for code in codes)


def _read_language(code: str) -> Language:
    texts = read_texts(code)
    return Language(code, *(texts[f"language.{part}"] for part in ("name", "locale", "tag")))


def require_language(code: str) -> str:
    """Return the code of a language that has a file; ValueError with all codes otherwise."""
    codes = [language.code for language in list_languages()]
    if code not in codes:
        raise ValueError(f"there is no language {code!r}; give one of {', '.join(codes)}")
    return code


LanguageCode = Annotated[str, AfterValidator(require_language)]
"""Code of a language that has a file."""


class PageSettings(BaseModel):
    """Address, users and language of a page."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)] = "127.0.0.1"
    """Address to listen on. The default is reached from this machine only; "0.0.0.0" or "::" from everywhere."""
    port: Annotated[int, Field(ge=0, le=65_535)] = 8460
    """TCP port; 0: any free one."""
    tls_certificate: Path | None = None
    """PEM file with the certificate chain; together with tls_key the page is served by HTTPS."""
    tls_key: Path | None = None
    """PEM file with its private key, without a passphrase."""
    limits: LimitSettings = LimitSettings()
    """Limits of the listening socket: the table [web.limits]."""
    access: AccessSettings = AccessSettings()
    """Users and sessions: the table [web.access]."""
    language: LanguageCode = DEFAULT_LANGUAGE
    """Language of the page until the user chooses another: the code of a file in ``data/web/languages``."""
    plant: Annotated[str, Field(max_length=60)] = ""
    """Name of the belt or plant, at the top of the page."""

    @model_validator(mode="after")
    def _whole_certificate(self) -> Self:
        if (self.tls_certificate is None) != (self.tls_key is None):
            missing = "tls_key" if self.tls_key is None else "tls_certificate"
            raise ValueError(f"{missing} is missing: TLS needs both tls_certificate and tls_key")
        return self


class WebSettings(PageSettings):
    """The operator's page of one belt: limits of what it shows, and its memory."""

    metrics_open: bool = False
    """If true, /metrics answers programs on this machine without login."""
    full_m3_h: Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)] | None = None
    """Rated flow of the belt; if given, the page shows the share that is used."""
    flow_window_s: Annotated[float, Field(ge=0.2, le=60)] = 3.0
    """Seconds of belt travel over which the current flow is averaged."""
    stale_s: Annotated[float, Field(ge=0.5, le=600)] = 3.0
    """Seconds without a frame, or without a measured record, after which numbers are no longer shown as current."""
    page_rate_hz: Annotated[float, Field(ge=0.2, le=25)] = 5.0
    """Most updates per second to an open page."""
    picture_px: Annotated[int, Field(ge=64, le=1280)] = 480
    """Longer side of the cameras' small pictures."""
    belt_m: Annotated[float, Field(ge=1, le=100)] = 20.0
    """Length of belt surface that is kept for its picture."""
    belt_cell_mm: Annotated[float, Field(ge=2, le=100)] = 10.0
    """Cell of that picture."""
