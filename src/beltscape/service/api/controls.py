"""Endpoints for operators: acknowledge an alarm, keep the recording, begin and end maintenance."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException
from pydantic import BaseModel, ConfigDict, Field

from beltscape.service.access import User, require_role
from beltscape.service.api.common import AlarmName, AppContext, ResponseModel, describe_refusals


class Done(ResponseModel):
    """It was done."""

    by: str


class KeepRecording(BaseModel):
    """Why the recording is kept."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    reason: Annotated[str, Field(min_length=1, max_length=200)]


class BeginMaintenance(BaseModel):
    """Why people work at the system, and for how long at most."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    reason: Annotated[str, Field(min_length=1, max_length=200)]
    minutes: Annotated[float, Field(ge=1, le=1440, allow_inf_nan=False)] = 30.0


def make_router(context: AppContext) -> APIRouter:
    """Return the routes of an operator's actions: alarms, the kept recording, maintenance."""
    router = APIRouter(prefix="/api", tags=["controls"])

    @router.post("/alarms/{name}/acknowledge", responses=describe_refusals(404, 409))
    def acknowledge(name: AlarmName, user: Annotated[User, Depends(require_role("operator"))]) -> Done:
        """Acknowledge the alarm of that name."""
        if all(alarm.name != name for alarm in context.live_state.take_snapshot().alarms):
            raise HTTPException(404, "there is no alarm of that name")
        if not context.controls.acknowledge(name, user.name):
            raise HTTPException(409, "that alarm is not waiting to be acknowledged")
        return Done(by=user.name)

    @router.post("/recording/keep", responses=describe_refusals(409))
    def keep(body: KeepRecording, user: Annotated[User, Depends(require_role("operator"))]) -> Done:
        """Keep the raw frames that the ring of the last minutes holds now."""
        if not context.controls.keep_recording(body.reason, user.name):
            raise HTTPException(409, "nothing is being recorded, or the recording is already kept")
        return Done(by=user.name)

    @router.post("/maintenance/begin", responses=describe_refusals(409))
    def begin_maintenance(
        body: BeginMaintenance, user: Annotated[User, Depends(require_role("operator"))]
    ) -> Done:
        """Begin maintenance, or set its reason and end anew: belt that passes is missing, in no total."""
        if not context.controls.begin_maintenance(body.reason, body.minutes, user.name):
            raise HTTPException(409, "maintenance cannot begin now")
        return Done(by=user.name)

    @router.post("/maintenance/end", responses=describe_refusals(409))
    def end_maintenance(user: Annotated[User, Depends(require_role("operator"))]) -> Done:
        """End maintenance before its time."""
        if not context.controls.end_maintenance(user.name):
            raise HTTPException(409, "there is no maintenance")
        return Done(by=user.name)

    return router
