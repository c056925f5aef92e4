"""Settings of the operator's page and its HTTP interface: [web] in project.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.plausibility import require_host
from beltscape.service.access.settings import AccessSettings, LimitSettings
from beltscape.service.languages import DEFAULT, LanguageCode


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
    language: LanguageCode = DEFAULT
    """Language of the page until the user chooses another: the code of a file in ``page/languages``."""
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
