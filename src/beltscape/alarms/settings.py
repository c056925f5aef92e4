"""What one may choose of every alarm: its limit, how far back clears it, its delays, how grave it is."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.live import Severity

Seconds = Annotated[float, Field(ge=0, le=86_400, allow_inf_nan=False)]
Length = Annotated[float, Field(ge=0, le=10_000_000, allow_inf_nan=False)]
Limit = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]
Share = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
Below = Annotated[float, Field(gt=0, le=1)]
"""Share of an upper limit by which the value must fall below it."""
Above = Annotated[float, Field(gt=0, le=10)]
"""Share of a lower limit by which the value must rise above it."""
Sigmas = Annotated[float, Field(ge=0, le=5)]


class Watch(BaseModel):
    """What all alarms have."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    enabled: bool = True
    """Whether it is judged at all."""
    severity: Severity = "warning"
    """"info", "warning" or "critical"."""
    latched: bool = True
    """Whether it stays on the list, once it is over, until somebody has acknowledged it."""
    after_s: Seconds = 0.0
    """Raised once the value has been past the limit for so long without a break."""
    clear_after_s: Seconds = 5.0
    """Over once the value has been back for so long without a break."""


class WatchAlong(Watch):
    """What alarms about the load have: delays also in belt that passed; both must have passed.

    Belt is counted by the ledger's position; while that is not known none passes.
    """

    after_mm: Length = 0.0
    """Raised once so much belt has passed with the value past the limit."""
    clear_after_mm: Length = 0.0
    """Over once so much belt has passed with the value back: on a stopped belt the load still lies there."""


class Overload(WatchAlong):
    """More on the belt than it may carry; every limit that is set counts, the rest are None."""

    severity: Severity = "critical"
    after_s: Seconds = 1.0
    fill: Share | None = 1.0
    """Cross-section over that of the fully loaded belt (DIN 22101)."""
    area_mm2: Limit | None = None
    volume_flow_m3_h: Limit | None = None
    mass_flow_t_h: Limit | None = None
    """Needs a bulk density: where that is not known, the alarm can neither be raised by it nor clear."""
    hysteresis: Below = 0.05
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 1.0
    """Past the limit by so many standard deviations of the value."""


class Empty(WatchAlong):
    """Nothing on the belt."""

    severity: Severity = "info"
    latched: bool = False
    after_s: Seconds = 10.0
    clear_after_s: Seconds = 2.0
    fill: Share | None = 0.02
    """Cross-section over that of the fully loaded belt."""
    area_mm2: Limit | None = None
    hysteresis: Above = 1.0
    """Over above limit·(1 + hysteresis)."""
    sigmas: Sigmas = 0.0


class BeltStopped(Watch):
    """The belt stands."""

    severity: Severity = "info"
    latched: bool = False
    after_s: Seconds = 3.0
    clear_after_s: Seconds = 1.0
    speed_mm_s: Limit = 20.0
    hysteresis: Above = 1.0
    """Over above limit·(1 + hysteresis)."""


class OversizeLump(Watch):
    """A lump that may block what comes after."""

    severity: Severity = "critical"
    clear_after_s: Seconds = 10.0
    size_mm: Limit | None = None
    """Sieve size; None: no alarm."""
    hysteresis: Below = 0.05
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 0.0
    """0: as soon as it is more likely than not, for a size's σ is large and a blocked chute is dear."""


class MisalignedBelt(Watch):
    """The belt runs off to a side."""

    after_s: Seconds = 5.0
    offset_mm: Limit = 50.0
    """To either side."""
    hysteresis: Below = 0.3
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 1.0


class LowCoverage(WatchAlong):
    """Little of what the cameras look at is measured: dirt, dust, light."""

    after_s: Seconds = 10.0
    coverage: Annotated[float, Field(gt=0, lt=1)] = 0.6
    """Share of the view, 0..1."""
    hysteresis: Above = 0.1
    """Over above limit·(1 + hysteresis)."""


class CameraLost(Watch):
    """A camera gives no usable image; one alarm per camera."""

    clear_after_s: Seconds = 3.0
    waiting_s: Seconds = 30.0
    """One that was not heard of since the start counts as lost after so long."""


class CameraSkew(Watch):
    """A camera's images are not of the same instant as the core's."""

    after_s: Seconds = 2.0
    skew_ms: Limit = 2.0
    hysteresis: Below = 0.5
    """Over below limit·(1 - hysteresis)."""


class FramesDropped(Watch):
    """More frame sets come than can be measured."""

    after_s: Seconds = 10.0
    per_minute: Limit = 6.0
    hysteresis: Below = 0.5
    """Over below limit·(1 - hysteresis)."""


class DiskFull(Watch):
    """The history cannot be written."""

    severity: Severity = "critical"


class RecordingPaused(Watch):
    """Raw frames are not being recorded though they should be."""


class EncoderSilent(Watch):
    """The encoder tells nothing; the belt's motion is taken from the material."""

    silent_s: Annotated[float, Field(gt=0, le=86_400)] = 2.0


class EncoderWrong(Watch):
    """What the encoder tells cannot be: it runs backwards, jumps, or cannot be read."""

    clear_after_s: Seconds = 10.0


class Slip(Watch):
    """Encoder and material tell different speeds: a slipping or worn wheel, or a wrong mm per count."""

    after_s: Seconds = 10.0
    clear_after_s: Seconds = 10.0
    share: Annotated[float, Field(gt=0, lt=1)] = 0.03
    """By which their ratio is off 1, to either side."""
    hysteresis: Below = 0.3
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 2.0


class NoMeasurement(Watch):
    """A quantity that was measured is not any more; one alarm per quantity, the load's also from the start."""

    severity: Severity = "critical"
    after_s: Seconds = 10.0
    clear_after_s: Seconds = 2.0
    start_after_s: Seconds = 60.0
    """The same for the load until it was first measured: cameras and the first strip of belt take their time."""
    seldom_after_s: Seconds = 120.0
    """The same for lumps and the belt's offset, which are measured now and then; these are back at once."""


class CertificateExpiring(Watch):
    """The web server's certificate ends soon."""

    days: Limit = 30.0
    hysteresis: Above = 0.05
    """Over above limit·(1 + hysteresis)."""


class AlarmSettings(BaseModel):
    """Settings of ``[alarms]``; the defaults suit most plants, limits of flow and lumps are the plant's own."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    overload: Overload = Overload()
    empty: Empty = Empty()
    belt_stopped: BeltStopped = BeltStopped()
    oversize_lump: OversizeLump = OversizeLump()
    misaligned_belt: MisalignedBelt = MisalignedBelt()
    low_coverage: LowCoverage = LowCoverage()
    camera_lost: CameraLost = CameraLost()
    camera_skew: CameraSkew = CameraSkew()
    frames_dropped: FramesDropped = FramesDropped()
    disk_full: DiskFull = DiskFull()
    recording_paused: RecordingPaused = RecordingPaused()
    encoder_silent: EncoderSilent = EncoderSilent()
    encoder_wrong: EncoderWrong = EncoderWrong()
    slip: Slip = Slip()
    no_measurement: NoMeasurement = NoMeasurement()
    certificate_expiring: CertificateExpiring = CertificateExpiring()
