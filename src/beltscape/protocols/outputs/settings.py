"""Settings of the table [outputs] of project.toml."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.plausibility import require_host

Address = Annotated[int, Field(ge=0, le=65_535)]
Amount = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
Quantity = Literal["flow_t_h", "flow_m3_h", "load_m2", "speed_m_s", "coverage"]


class _Table(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PulseSettings(_Table):
    """One pulse per mass or volume: the table [outputs.pulse]."""

    kg: Amount | None = None
    """Mass of a pulse; it needs a density."""
    l: Amount | None = None  # noqa: E741
    """Volume of a pulse in litres, where ``kg`` is not given."""
    kind: Literal["coil", "counter"] = "coil"
    """A coil that is switched on and off for every pulse, or two holding registers with the count, modulo 2³²."""
    address: Address
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


class AnalogueSettings(_Table):
    """A current of 4 to 20 mA: an entry of [[outputs.analogue]]."""

    value: Quantity
    address: Address
    """Holding register of the output."""
    zero: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)] = 0.0
    """Value at 4 mA."""
    full: Annotated[float, Field(ge=-1e6, le=1e6, allow_inf_nan=False)]
    """Value at 20 mA."""
    register_4_ma: Address = 4000
    """What the module takes for 4 mA; the default is µA."""
    register_20_ma: Address = 20_000
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


class OutputSettings(_Table):
    """The I/O module, its pulse output and its analogue outputs."""

    host: Annotated[str, Field(max_length=253), AfterValidator(require_host)]
    """Name or address of the module."""
    port: Annotated[int, Field(ge=1, le=65_535)] = 502
    """TCP port."""
    unit: Annotated[int, Field(ge=0, le=255)] = 1
    """Unit identifier of the module."""
    every_s: Annotated[float, Field(ge=0.05, le=60)] = 0.2
    """Period of the analogue outputs and of the search for new pulses."""
    heartbeat: Address | None = None
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
