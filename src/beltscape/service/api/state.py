"""Endpoints of the current state: flow, totals, cameras and their last images, alarms, page settings."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException, Response
from pydantic import Field

from beltscape.core.events import CameraHealth, CameraState
from beltscape.core.ledger import Standing, Totals
from beltscape.core.translatable_message import get_key, get_values
from beltscape.files.json_number import Number
from beltscape.service.access import User, require_role
from beltscape.service.api.alarms import AlarmOut
from beltscape.service.api.common import AppContext, CameraName, ResponseModel, describe_refusals
from beltscape.service.view_models import PICTURE_MEDIA_TYPE, Snapshot, Trend


class FlowOut(ResponseModel):
    """Flow over the last seconds of belt travel; null: not known."""

    volume_m3_h: Number
    sigma_m3_h: Annotated[Number, Field(description="One standard deviation")]
    mass_t_h: Annotated[Number, Field(description="null where the bulk density is not known")]
    mass_sigma_t_h: Number
    area_m2: Annotated[Number, Field(description="Mean cross-section of the load")]
    coverage: Annotated[Number, Field(description="Share of the belt that was measured, 0..1")]
    trend: Annotated[Trend, Field(description="Against the minute before")]
    change: Annotated[Number, Field(description="Relative change against the minute before")]
    standing: Annotated[Standing, Field(description="The worst standing in it")]
    age_s: Annotated[Number, Field(description="Since the last measured record; null: there was none yet")]


class FramesOut(ResponseModel):
    """Counts and timing of frame sets."""

    done: int
    dropped: int
    repeated: Annotated[int, Field(description="Not matched: the belt of the last one, at rest or creeping")]
    waiting: int
    seconds: Annotated[Number, Field(description="Time that the last one took")]
    coverage: Annotated[Number, Field(description="Share of the last one that was measured, 0..1")]
    speed_m_s: Annotated[Number, Field(description="Of the belt")]
    capacity_per_s: Annotated[Number, Field(description="Sets that the computer can measure in a second")]
    capacity_m_s: Annotated[Number, Field(description="Speed up to which two sets show every millimetre")]
    age_s: Annotated[Number, Field(description="Since the last one; null: there was none yet")]


class TotalsOut(ResponseModel):
    """Totals of the ledger."""

    records: int
    volume_m3: float
    sigma_m3: Number
    mass_t: Number
    valid_m: float
    degraded_m: float
    missing_m: float
    since_ms: Annotated[int | None, Field(description="System clock at the first record")]

    @classmethod
    def from_totals(cls, totals: Totals) -> TotalsOut:
        """Return the totals in m³, t and m."""
        return cls(
            records=totals.records,
            volume_m3=totals.volume_mm3 * 1e-9,
            sigma_m3=totals.sigma_mm3 * 1e-9,
            mass_t=totals.mass_kg * 1e-3,
            valid_m=totals.valid_mm * 1e-3,
            degraded_m=totals.degraded_mm * 1e-3,
            missing_m=totals.missing_mm * 1e-3,
            since_ms=None if totals.since_ns is None else totals.since_ns // 1_000_000,
        )


class CameraOut(ResponseModel):
    """Health of one camera."""

    name: str
    state: CameraState
    frames: int
    missed: int
    rate_hz: Number
    skew_ms: Number
    message: Annotated[str, Field(description="The fault and the fix, in English")]
    cause: Annotated[str, Field(description="Key of the message for translations; empty: none")]
    values: Annotated[dict[str, float | int | str], Field(description="Values in the message")]
    picture: Annotated[str | None, Field(description="Frame of its newest picture; null: there is none")]

    @classmethod
    def from_health(cls, camera: CameraHealth, picture: str | None) -> CameraOut:
        """Return a camera's health and its newest picture's frame."""
        return cls(
            name=camera.name,
            state=camera.state,
            frames=camera.frames,
            missed=camera.missed,
            rate_hz=camera.rate_hz,
            skew_ms=camera.skew_ms,
            message=camera.message,
            cause=get_key(camera.message),
            values=get_values(camera.message),
            picture=picture,
        )


class MaintenanceOut(ResponseModel):
    """The present maintenance: the belt that passes is missing."""

    reason: str
    by: Annotated[str, Field(description="Who began it")]
    since_ms: int
    until_ms: Annotated[int, Field(description="When it ends by itself")]


class NoteOut(ResponseModel):
    """A message of the running system."""

    wall_ms: int
    text: str


class StateOut(ResponseModel):
    """The current state without pictures."""

    wall_ms: Annotated[int, Field(description="System clock of the machine that measures")]
    frames: FramesOut
    flow: FlowOut
    totals: TotalsOut
    cameras: tuple[CameraOut, ...]
    alarms: Annotated[tuple[AlarmOut, ...], Field(description="All that are not clear")]
    hidden_alarms: Annotated[tuple[AlarmOut, ...], Field(description="Shelved or out of service")]
    notes: tuple[NoteOut, ...]
    record: Annotated[int | None, Field(description="Number of the newest record")]
    stale_s: Annotated[float, Field(description="Age from which frames and records are not current")]
    health_age_s: Annotated[Number, Field(description="Since the cameras' health was reported")]
    maintenance: Annotated[MaintenanceOut | None, Field(description="null: there is none")]

    @classmethod
    def from_snapshot(cls, snapshot: Snapshot) -> StateOut:
        """Return the snapshot in m³, t and m."""
        frames, flow, present = snapshot.frames, snapshot.flow, snapshot.maintenance
        return cls(
            wall_ms=snapshot.wall_ns // 1_000_000,
            frames=FramesOut(
                done=frames.done,
                dropped=frames.dropped,
                repeated=frames.repeated,
                waiting=frames.waiting,
                seconds=frames.seconds,
                coverage=frames.coverage,
                speed_m_s=frames.speed_mm_s * 1e-3,
                capacity_per_s=frames.capacity.sets_per_s,
                capacity_m_s=frames.capacity.speed_mm_s * 1e-3,
                age_s=snapshot.frame_age_s,
            ),
            flow=FlowOut(
                volume_m3_h=flow.volume_m3_h,
                sigma_m3_h=flow.sigma_m3_h,
                mass_t_h=flow.mass_t_h,
                mass_sigma_t_h=flow.mass_sigma_t_h,
                area_m2=flow.area_mm2 * 1e-6,
                coverage=flow.coverage,
                trend=flow.trend,
                change=flow.change,
                standing=flow.standing,
                age_s=flow.age_s,
            ),
            totals=TotalsOut.from_totals(snapshot.totals),
            cameras=tuple(
                CameraOut.from_health(camera, snapshot.picture_frames.get(camera.name))
                for camera in snapshot.cameras
            ),
            alarms=tuple(AlarmOut.from_alarm(alarm) for alarm in snapshot.alarms if alarm.state != "clear"),
            hidden_alarms=tuple(
                AlarmOut.from_alarm(alarm)
                for alarm in snapshot.alarms
                if alarm.is_listed and alarm.state == "clear"
            ),
            notes=tuple(NoteOut(wall_ms=wall_ms, text=text) for wall_ms, text in snapshot.notes),
            record=snapshot.record,
            stale_s=snapshot.stale_s,
            health_age_s=snapshot.health_age_s,
            maintenance=None
            if present is None
            else MaintenanceOut(
                reason=present.reason,
                by=present.by,
                since_ms=present.since_ns // 1_000_000,
                until_ms=present.until_ns // 1_000_000,
            ),
        )


class PageOut(ResponseModel):
    """Settings of the page and the signed-in user."""

    plant: str
    language: Annotated[str, Field(description="Code of the language that the page begins with")]
    full_m3_h: float | None
    stale_s: float
    version: str
    user: str
    role: str
    has_production: Annotated[bool, Field(description="Whether there are products, batches and shifts")]
    shelving_max_min: Annotated[float, Field(description="Longest time for which an alarm may be shelved")]
    alarm_texts: Annotated[
        dict[str, dict[str, dict[str, str]]], Field(description="The plant's own texts by language and alarm")
    ]


def make_router(context: AppContext) -> APIRouter:
    """Return the routes GET /api/state and /api/page."""
    router = APIRouter(prefix="/api", tags=["now"])

    @router.get("/state", responses=describe_refusals())
    def state(_: Annotated[User, Depends(require_role("viewer"))]) -> StateOut:
        """Flow, totals, cameras and alarms as they are now."""
        return StateOut.from_snapshot(context.live_state.take_snapshot())

    @router.get("/page", responses=describe_refusals())
    def page(user: Annotated[User, Depends(require_role("viewer"))]) -> PageOut:
        """The signed-in user and the settings of the page."""
        from beltscape import __version__

        settings = context.settings
        return PageOut(
            plant=settings.plant,
            language=settings.language,
            full_m3_h=settings.full_m3_h,
            stale_s=settings.stale_s,
            version=__version__,
            user=user.name,
            role=user.role,
            has_production=context.production is not None,
            shelving_max_min=context.controls.alarm_controls.shelving_max_min,
            alarm_texts={
                code: {name: dict(text) for name, text in alarms.items()}
                for code, alarms in context.controls.alarm_controls.own_texts.items()
            },
        )

    return router


def make_pictures_router(context: AppContext) -> APIRouter:
    """Return the route GET /api/cameras/{name}/picture."""
    router = APIRouter(prefix="/api", tags=["now"])

    @router.get(
        "/cameras/{name}/picture",
        response_class=Response,
        responses=describe_refusals(404)
        | {200: {"content": {PICTURE_MEDIA_TYPE: {}}, "description": "WebP"}},
    )
    def picture(name: CameraName, _: Annotated[User, Depends(require_role("viewer"))]) -> Response:
        """The camera's last image; headers ``Beltscape-Frame`` and ``Beltscape-Wall-Ms`` give its name and time."""
        image = context.live_state.get_picture(name)
        if image is None:
            raise HTTPException(404, "no camera of that name has sent an image yet")
        headers = {
            "Cache-Control": "no-store",
            "Beltscape-Frame": image.frame.encode("ascii", "replace").decode(),
            "Beltscape-Wall-Ms": str(image.wall_ns // 1_000_000),
        }
        return Response(image.data, media_type=PICTURE_MEDIA_TYPE, headers=headers)

    return router
