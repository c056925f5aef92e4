"""Settings of the encoder."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import BELT_SPEED_MM, ENCODER_STEP, FASTEST_SPEED, require_host

EncoderKind = Literal["capture", "file", "udp", "constant", "camera", "none"]
"""capture: a recorded capture's encoder.csv, by frame; file: a CSV file that grows; udp: datagrams; constant: a given
speed; camera: the cameras send it with their images; none: the belt's motion is taken from the material"""


class EncoderSettings(BaseModel):
    """Settings of ``[encoder]``."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    kind: EncoderKind = "none"
    path: str = ""
    """The file that grows, or a recorded table in place of the capture's own; beside project.toml unless absolute."""
    host: Annotated[str, AfterValidator(require_host)] = "127.0.0.1"
    """Address that receives datagrams; if other machines can reach it, ``sender`` should be set."""
    port: Annotated[int, Field(ge=1, le=65_535)] = 8461
    """UDP port that receives datagrams."""
    sender: str = ""
    """Address of the only machine whose datagrams are accepted; empty: any."""
    speed_mm_s: Annotated[float, BELT_SPEED_MM] | None = None
    """Speed of a belt without an encoder that always runs at one speed."""
    times: Literal["device", "arrival", "steady"] = "device"
    """device: timestamps of any clock, converted to this machine's by the readings with the least delay; arrival:
    timestamps are ignored; steady: timestamps of this machine's CLOCK_MONOTONIC. A reading without one is stamped
    on arrival."""
    mm_per_count: Annotated[float, ENCODER_STEP] = 1.0
    """1 where positions come in mm."""
    counter_bits: Literal[16, 32] | None = None
    """Width of a counter that wraps; None: it does not."""
    reverse: bool = False
    """Whether its count falls as the belt travels."""
    fastest_mm_s: Annotated[float, FASTEST_SPEED] = 12_000.0
    """A step that is longer than this within ``silent_s`` is no travel but a reset or a fault."""
    silent_s: Annotated[float, Field(gt=0, le=60)] = 1.0
    """Longest gap between readings that is interpolated; the encoder must send this often, also on a stopped belt."""
    wait_s: Annotated[float, Field(ge=0, le=1)] = 0.05
    """Longest wait of a frame for the reading after it."""
    poll_s: Annotated[float, Field(ge=0.001, le=1)] = 0.02
    """Interval between reads of the growing file."""

    @model_validator(mode="after")
    def _complete(self) -> EncoderSettings:
        if self.kind == "file" and not self.path:
            raise ValueError('kind "file" needs path = "…", the CSV file that grows')
        if self.kind == "constant" and self.speed_mm_s is None:
            raise ValueError('kind "constant" needs speed_mm_s = …')
        return self
