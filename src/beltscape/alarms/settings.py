"""Settings of the alarms: limits, hysteresis, delays, severity, and their suppression, shelving and groups.

Default delays and limits are chosen for plants in general: long enough that a single lump, a restart or a late frame
raises no alarm, short enough for a person to act. ``docs/reference/alarms.md`` lists them.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from beltscape.core.alarm_catalogue import (
    CHECKS,
    DEFINITIONS,
    GROUPS,
    KINDS,
    STATES,
    UNMEASURED,
    list_suppressed,
    split_name,
)
from beltscape.core.alarms import Priority, Severity
from beltscape.core.errors import suggest_name
from beltscape.core.quantities import CROSS_SECTION, LUMP, OFFSET, STOPPED_SPEED


def require_check(name: str) -> str:
    """Return the name of a check; ValueError with the most similar one if there is none of that name."""
    if name in CHECKS:
        return name
    hint = suggest_name(name, CHECKS) or f"give one of {', '.join(CHECKS)}"
    raise ValueError(f"no check is called {name!r}; {hint}")


def require_alarm(name: str) -> str:
    """Return the name of an alarm; ValueError with the most similar kind if its kind does not exist."""
    kind = split_name(name)[0]
    if kind in DEFINITIONS:
        return name
    known = (*KINDS, *CHECKS)
    hint = suggest_name(kind, known) or f"give one of {', '.join(known)}"
    raise ValueError(f"no alarm is called {name!r}; {hint}")


AlarmKey = Annotated[str, AfterValidator(require_alarm)]
"""Name of an alarm, or of a kind of alarms: "camera_lost:cam2" or "camera_lost"."""


class SuppressionSettings(BaseModel):
    """The alarms that are suppressed by a state of the plant; they are evaluated and journalled, but not shown."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    maintenance: tuple[AlarmKey, ...] = list_suppressed("maintenance")
    """During maintenance: all that depend on what the cameras see."""
    belt_stopped: tuple[AlarmKey, ...] = list_suppressed("belt_stopped")
    """While the alarm belt_stopped is on: no new belt comes into view."""
    cameras_off: tuple[AlarmKey, ...] = list_suppressed("cameras_off")
    """While the alarm cameras_off is on for a bank; alarms of single cameras only for those of the bank."""
    frames_dropped: tuple[AlarmKey, ...] = list_suppressed("frames_dropped")
    """While the alarm frames_dropped is on: what comes of frames that are not measured."""
    encoder_silent: tuple[AlarmKey, ...] = list_suppressed("encoder_silent")
    """While the alarm encoder_silent is on: readings that do not come contradict the material."""
    encoder_wrong: tuple[AlarmKey, ...] = list_suppressed("encoder_wrong")
    """While the alarm encoder_wrong is on: wrong readings contradict the material."""
    unmeasured: tuple[AlarmKey, ...] = UNMEASURED
    """While the core camera is lost, or a fault is on that leaves nothing to measure, and its alarm is shown."""

    def by_state(self) -> dict[str, tuple[str, ...]]:
        """Return the alarms of every state."""
        return {state: getattr(self, state) for state in STATES}


class ShelvingSettings(BaseModel):
    """Shelving: an operator hides an alarm for a time."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    max_min: Annotated[float, Field(ge=1, le=10_080, allow_inf_nan=False)] = 480.0
    """Longest time in minutes: a shift, so that each shift decides anew."""
    never: tuple[AlarmKey, ...] = ()
    """Alarms that may not be shelved."""


def _check_groups(groups: Mapping[str, tuple[str, ...]]) -> Mapping[str, tuple[str, ...]]:
    """Return the groups; ValueError where an alarm is in two of them."""
    seen: dict[str, str] = {}
    for group, members in groups.items():
        for member in members:
            if member in seen:
                raise ValueError(f"{member!r} is in {seen[member]!r} and in {group!r}; give it one group")
            seen[member] = group
    return groups


Groups = Annotated[Mapping[str, tuple[AlarmKey, ...]], AfterValidator(_check_groups)]
"""Alarms with common causes by the name of their group, causes before effects."""

Seconds = Annotated[float, Field(ge=0, le=86_400, allow_inf_nan=False)]
"""A time, up to a day."""
Length = Annotated[float, Field(ge=0, le=10_000_000, allow_inf_nan=False)]
"""A length of belt in mm, up to 10 km."""
Limit = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]
"""A limit of a quantity; the bound only catches slips of the keyboard."""
Share = Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
"""A share, which can exceed 1: an overloaded belt."""
Below = Annotated[float, Field(gt=0, le=1)]
"""Share of an upper limit by which the value must fall below it."""
Above = Annotated[float, Field(gt=0, le=10)]
"""Share of a lower limit by which the value must rise above it."""
Sigmas = Annotated[float, Field(ge=0, le=5)]
"""A number of standard deviations; beyond 5 a limit would be another one."""
CheckName = Annotated[str, AfterValidator(require_check)]
"""Name of a check, as in its findings."""


class CommonSettings(BaseModel):
    """Settings that all alarms have."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    enabled: bool = True
    """Whether the alarm is evaluated."""
    severity: Severity = "warning"
    """"info", "warning" or "critical"."""
    latched: bool = True
    """Whether the alarm stays on the list after its condition has ended until it is acknowledged."""
    needs_reset: bool = False
    """Whether it stays until it is acknowledged and, after its condition has ended, reset by a person."""
    after_s: Seconds = 0.0
    """Raised once the value has been past the limit for this time without a break."""
    clear_after_s: Seconds = 5.0
    """Over once the value has been back for this time without a break."""


class LoadSettings(CommonSettings):
    """Settings of alarms about the load: delays also in belt travel; time and travel must both have passed.

    Travel is counted by the ledger's position; while that is unknown, no travel is counted.
    """

    after_mm: Length = 0.0
    """Raised once this length of belt has passed with the value past the limit."""
    clear_after_mm: Length = 0.0
    """Over once this length of belt has passed with the value back: on a stopped belt the load still lies there."""


class Overload(LoadSettings):
    """More on the belt than it may carry; every limit that is set counts, the rest are None."""

    severity: Severity = "critical"
    after_s: Seconds = 1.0
    fill: Share | None = 1.0
    """Cross-section over that of the fully loaded belt (DIN 22101)."""
    area_mm2: Annotated[float, CROSS_SECTION] | None = None
    volume_flow_m3_h: Limit | None = None
    mass_flow_t_h: Limit | None = None
    """Needs a bulk density; without one this limit can neither raise nor clear the alarm."""
    hysteresis: Below = 0.05
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 1.0
    """The value must exceed the limit by this number of its standard deviations."""


class Empty(LoadSettings):
    """The belt carries no load."""

    severity: Severity = "info"
    latched: bool = False
    after_s: Seconds = 10.0
    clear_after_s: Seconds = 2.0
    fill: Share | None = 0.02
    """Cross-section over that of the fully loaded belt."""
    area_mm2: Annotated[float, CROSS_SECTION] | None = None
    hysteresis: Above = 1.0
    """Over above limit·(1 + hysteresis)."""
    sigmas: Sigmas = 0.0


class BeltStopped(CommonSettings):
    """The belt stands."""

    severity: Severity = "info"
    latched: bool = False
    after_s: Seconds = 3.0
    clear_after_s: Seconds = 1.0
    speed_mm_s: Annotated[float, STOPPED_SPEED] = 20.0
    """Belts run at 500 mm/s and more; a stopped belt creeps."""
    hysteresis: Above = 1.0
    """Over above limit·(1 + hysteresis)."""


class OversizeLump(CommonSettings):
    """A lump that may block the next transfer."""

    severity: Severity = "critical"
    clear_after_s: Seconds = 10.0
    size_mm: Annotated[float, LUMP] | None = None
    """Sieve size; None: no alarm."""
    hysteresis: Below = 0.05
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 0.0
    """0: raised at even odds, because a size's σ is large and a blocked chute is expensive."""


class MisalignedBelt(CommonSettings):
    """The belt runs off to a side."""

    after_s: Seconds = 5.0
    offset_mm: Annotated[float, OFFSET] = 50.0
    """Limit to either side."""
    hysteresis: Below = 0.3
    """Over below limit·(1 - hysteresis)."""
    sigmas: Sigmas = 1.0


class LowCoverage(LoadSettings):
    """Too little of the cameras' view is measured: dirt, dust, light."""

    after_s: Seconds = 10.0
    coverage: Annotated[float, Field(gt=0, lt=1)] = 0.6
    """Share of the view, 0..1."""
    hysteresis: Above = 0.1
    """Over above limit·(1 + hysteresis)."""


class CamerasOff(CommonSettings):
    """All cameras of a bank are silent: one cause, such as their supply; one alarm per bank."""

    severity: Severity = "critical"
    clear_after_s: Seconds = 3.0
    waiting_s: Seconds = 30.0
    """Cameras without an image since the start count as off after this time."""
    banks: Mapping[str, tuple[str, ...]] = Field(default_factory=dict[str, tuple[str, ...]])
    """Cameras by the name of their bank: what shares a supply or a switch; none: all cameras are one bank."""


class CameraLost(CommonSettings):
    """A camera delivers no usable image; one alarm per camera."""

    clear_after_s: Seconds = 3.0
    waiting_s: Seconds = 30.0
    """A camera without an image since the start counts as lost after this time."""


class CameraSkew(CommonSettings):
    """A camera's images are not of the same instant as the core's."""

    after_s: Seconds = 2.0
    skew_ms: Limit = 2.0
    """A belt at 2 m/s moves by 4 mm in that time."""
    hysteresis: Below = 0.5
    """Over below limit·(1 - hysteresis)."""


class FramesDropped(CommonSettings):
    """More frame sets arrive than can be measured."""

    after_s: Seconds = 10.0
    per_minute: Limit = 6.0
    """Number of dropped frame sets."""
    hysteresis: Below = 0.5
    """Over below limit·(1 - hysteresis)."""


class DiskFull(CommonSettings):
    """The history cannot be written."""

    severity: Severity = "critical"


class HistoryRepaired(CommonSettings):
    """The database was damaged, emptied or changed by another program, and was repaired."""


class UsersUnreadable(CommonSettings):
    """The users' database is damaged: nobody can sign in, measuring continues."""


class ReportsFailing(CommonSettings):
    """Reports are not written, mailed or printed; measuring continues."""


class RecordingPaused(CommonSettings):
    """Raw frames should be recorded and are not."""


class GpuLost(CommonSettings):
    """The graphics processor failed; the processor matches until the program starts again."""


class EncoderSilent(CommonSettings):
    """The encoder sends nothing; the belt's motion is taken from the material."""

    silent_s: Annotated[float, Field(gt=0, le=86_400)] = 2.0
    """Time without a reading."""


class EncoderWrong(CommonSettings):
    """The encoder's readings are impossible: it runs backwards, jumps, or is unreadable."""

    clear_after_s: Seconds = 10.0


class NoMeasurement(CommonSettings):
    """A quantity is no longer measured; one alarm per quantity, the load's also from the start."""

    severity: Severity = "critical"
    after_s: Seconds = 10.0
    clear_after_s: Seconds = 2.0
    start_after_s: Seconds = 60.0
    """``after_s`` of the load before its first measurement: cameras and the first strip of belt take time."""
    seldom_after_s: Seconds = 120.0
    """``after_s`` of lumps and the belt's offset, which are measured periodically; they clear at once."""


class CertificateExpiring(CommonSettings):
    """The web server's certificate ends soon."""

    days: Limit = 30.0
    """Days before its end, as `tls.SOON_DAYS`: certificates of Let's Encrypt are renewed at 30."""
    hysteresis: Above = 0.05
    """Over above limit·(1 + hysteresis)."""


class MaterialTestDue(CommonSettings):
    """The certificate of the material test ends soon, or has ended."""

    days: Limit = 14.0
    """Days before its end. Chosen: a test must be planned, with a truck and a scale."""
    hysteresis: Above = 0.05
    """Over above limit·(1 + hysteresis)."""


class VoidCertificate(CommonSettings):
    """What the certificate of the material test applies to has changed: rig, belt, settings, networks or program."""


class FaultAlarm(CommonSettings):
    """A check found a fault of the system; one alarm per check, with its name, and per camera.

    Unless the severity is set, it is critical where nothing is measured because of the fault, else warning.
    """

    clear_after_s: Seconds = 10.0


_OWN_DEFAULTS = {
    name: FaultAlarm(**one.fault_defaults) for name, one in DEFINITIONS.items() if one.fault_defaults
}


class AlarmSettings(BaseModel):
    """Settings of ``[alarms]``; the defaults suit most plants, but limits of flow and lumps depend on the plant."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    overload: Overload = Overload()
    empty: Empty = Empty()
    belt_stopped: BeltStopped = BeltStopped()
    oversize_lump: OversizeLump = OversizeLump()
    misaligned_belt: MisalignedBelt = MisalignedBelt()
    low_coverage: LowCoverage = LowCoverage()
    cameras_off: CamerasOff = CamerasOff()
    camera_lost: CameraLost = CameraLost()
    camera_skew: CameraSkew = CameraSkew()
    frames_dropped: FramesDropped = FramesDropped()
    disk_full: DiskFull = DiskFull()
    history_repaired: HistoryRepaired = HistoryRepaired()
    users_unreadable: UsersUnreadable = UsersUnreadable()
    reports_failing: ReportsFailing = ReportsFailing()
    recording_paused: RecordingPaused = RecordingPaused()
    gpu_lost: GpuLost = GpuLost()
    encoder_silent: EncoderSilent = EncoderSilent()
    encoder_wrong: EncoderWrong = EncoderWrong()
    no_measurement: NoMeasurement = NoMeasurement()
    certificate_expiring: CertificateExpiring = CertificateExpiring()
    material_test_due: MaterialTestDue = MaterialTestDue()
    test_certificate_void: VoidCertificate = VoidCertificate()
    faults: FaultAlarm = FaultAlarm()
    """Of the faults of all checks that have no settings of their own."""
    checks: Mapping[CheckName, FaultAlarm] = Field(default_factory=dict[str, FaultAlarm])
    """Of the faults of one check, by its name: ``[alarms.checks.zero_shift]``."""
    priorities: Mapping[AlarmKey, Priority] = Field(default_factory=dict[str, Priority])
    """Priorities that replace the defaults, by alarm or kind: ``"camera_lost:cam2" = "low"``."""
    groups: Groups = GROUPS
    """Groups for first-out, which replace the default groups."""
    suppression: SuppressionSettings = SuppressionSettings()
    shelving: ShelvingSettings = ShelvingSettings()
    texts: Path | None = None
    """TOML file with the plant's own texts of alarms."""

    def select_fault(self, check: str) -> FaultAlarm:
        """Return the settings of a check's alarms."""
        return self.checks.get(check) or _OWN_DEFAULTS.get(check, self.faults)
