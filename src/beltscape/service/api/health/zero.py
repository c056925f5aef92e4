"""Endpoints for engineers: the empty belt's zero, measured first and then set by a confirmation."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException
from fastapi.responses import JSONResponse
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import MeasureError, OutputError
from beltscape.core.live.translatable_message import get_key, get_values
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, Problem, ResponseModel, describe_refusals
from beltscape.service.api.controls import Done

Engineer = Annotated[User, Depends(require_role("engineer"))]


class ZeroOut(ResponseModel):
    """The motion of the empty belt since it was learned; nothing is set yet."""

    number: Annotated[int, Field(description="To be confirmed with")]
    offset_mm: Annotated[float, Field(description="Mean rise of the belt")]
    sigma_mm: float
    tilt_mm: Annotated[float, Field(description="Largest rise of an edge or end of the view")]
    frames: int
    limit_mm: float


class ZeroRefusal(Problem):
    """Why the zero cannot be set, with the parts from which a page composes its text."""

    cause: str
    values: dict[str, float | int | str]


class SetZero(BaseModel):
    """The measurement that is confirmed."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    number: Annotated[int, Field(ge=1)]


def make_router(context: AppContext) -> APIRouter:
    """Return the routes POST /api/zero/measure and /api/zero/set."""
    router = APIRouter(prefix="/api/zero", tags=["health"])
    refusals = describe_refusals(503) | {409: {"model": ZeroRefusal, "description": "It cannot be measured"}}

    @router.post("/measure", responses=refusals, response_model=ZeroOut)
    def measure_zero(_: Engineer) -> ZeroOut | JSONResponse:
        """Measure the zero on the next frames of the empty running belt; takes up to 20 seconds."""
        try:
            found = context.controls.measure_zero()
        except MeasureError as error:
            text = error.args[0]
            refusal = ZeroRefusal(detail=str(text), cause=get_key(text), values=get_values(text))
            return JSONResponse(refusal.model_dump(), status_code=409)
        return ZeroOut(
            number=found.number,
            offset_mm=found.offset_mm,
            sigma_mm=found.sigma_mm,
            tilt_mm=found.tilt_mm,
            frames=found.frames,
            limit_mm=found.limit_mm,
        )

    @router.post("/set", responses=describe_refusals(409, 503))
    def set_zero(body: SetZero, user: Engineer) -> Done:
        """Set the zero to the last measurement; it holds from the next frame on and over restarts."""
        try:
            is_set = context.controls.set_zero(body.number, user.name)
        except OutputError as error:
            raise HTTPException(503, str(error)) from error
        if not is_set:
            raise HTTPException(409, "that measurement is not the last one, too old, or set already")
        return Done(by=user.name)

    return router
