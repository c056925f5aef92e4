"""Settings of the table [modbus] of project.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.plausibility import require_host

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
