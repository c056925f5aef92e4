"""Settings of the table [opcua] of project.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.plausibility import require_host

Limit = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
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
