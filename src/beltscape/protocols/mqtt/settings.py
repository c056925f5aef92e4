"""Settings of the table [mqtt] of project.toml."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, field_validator, model_validator

from beltscape.core.plausibility import require_host

_Id = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^+#/\x00]+$")]


class SparkplugSettings(BaseModel):
    """Names of Sparkplug B: the table [mqtt.sparkplug]."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    group: _Id = "Beltscape"
    """Group of edge nodes, such as the plant."""
    node: _Id = "beltscape"
    """This edge node; give every machine its own."""
    device: _Id = "belt"
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
