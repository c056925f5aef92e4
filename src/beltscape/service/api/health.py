"""Endpoints for engineers: the checks of the system by its own data, its learned images, the empty belt's zero.

Checks are shown as they are now and over time. What sound images show is learned anew after cleaning, or after work
at lenses and lights. The zero is measured first and then set by a confirmation.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from fastapi import APIRouter, Depends, HTTPException, Query
from fastapi.responses import JSONResponse
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from beltscape.core.errors import MeasureError, OutputError
from beltscape.core.findings import EFFECTS, Effect
from beltscape.core.translatable_message import get_key, get_values
from beltscape.files.json_number import Number
from beltscape.service.access import User, require_role
from beltscape.service.api.common import (
    AppContext,
    Problem,
    ResponseModel,
    WallMs,
    check_period,
    describe_refusals,
)
from beltscape.service.api.controls import Done
from beltscape.service.api.history import MS_NS, map_history_errors
from beltscape.service.view_models import CheckState
from beltscape.sinks.historian import FindingSeries

Engineer = Annotated[User, Depends(require_role("engineer"))]
CheckName = Annotated[str, Query(min_length=1, max_length=60, description="Name of a check")]
Subject = Annotated[str, Query(max_length=64, description="Name of a camera; empty: the whole system")]
Box = tuple[float, float, float, float]


class CheckOut(ResponseModel):
    """The newest finding of a check; null: not known."""

    check: str
    subject: Annotated[str, Field(description="Camera; empty: the whole system")]
    unit: str
    value: Number
    sigma: Annotated[Number, Field(description="One standard deviation")]
    limit: Annotated[Number, Field(description="Value beyond which, with its sigma, it is a fault")]
    effect: Annotated[Effect, Field(description="On the records: none, degraded, missing")]
    fault: bool
    cause: Annotated[str, Field(description="Key of the fault's text in other languages; empty: none")]
    values: Annotated[dict[str, float | int | str], Field(description="The values in that text")]
    text: Annotated[str, Field(description="The fault and the fix, in English; empty: no fault")]
    place: Annotated[
        Box | None, Field(description="Left, top, right, bottom in the camera's image, shares 0..1")
    ]
    wall_ms: Annotated[int | None, Field(description="When it was made; null: before this start")]
    age_s: Number

    @classmethod
    def from_state(cls, state: CheckState) -> CheckOut:
        """Return the state with its time in ms."""
        finding = state.finding
        return cls(
            check=finding.check,
            subject=finding.subject,
            unit=finding.unit,
            value=finding.value,
            sigma=finding.sigma,
            limit=finding.limit,
            effect=finding.effect,
            fault=finding.is_fault,
            cause=finding.cause,
            values=get_values(finding.text),
            text=finding.text,
            place=None if finding.place is None else (*map(float, finding.place),),
            wall_ms=state.wall_ns // MS_NS,
            age_s=state.age_s,
        )


class CheckSeriesOut(ResponseModel):
    """The findings of a check over equal intervals; null: not measured."""

    start_ms: Annotated[tuple[int, ...], Field(description="System clock at which each interval begins")]
    width_ms: float
    mean: tuple[Number, ...]
    low: tuple[Number, ...]
    high: tuple[Number, ...]
    sigma: tuple[Number, ...]
    limit: tuple[Number, ...]
    effect: Annotated[tuple[Effect, ...], Field(description="The worst in each interval")]
    faults: Annotated[tuple[int, ...], Field(description="Stored findings that were faults")]

    @classmethod
    def from_series(cls, series: FindingSeries) -> CheckSeriesOut:
        """Return the series with its times in ms."""
        return cls(
            start_ms=tuple(int(ns) // MS_NS for ns in series.start_ns),
            width_ms=series.width_ns / MS_NS,
            mean=_to_json_numbers(series.mean),
            low=_to_json_numbers(series.low),
            high=_to_json_numbers(series.high),
            sigma=_to_json_numbers(series.sigma),
            limit=_to_json_numbers(series.limit),
            effect=tuple(EFFECTS[int(place)] for place in series.effect),
            faults=tuple(int(count) for count in series.faults),
        )


class CheckKeyOut(ResponseModel):
    """A check that has a series."""

    check: str
    subject: str
    unit: str


def make_router(context: AppContext) -> APIRouter:
    """Return the routes GET /api/checks, /api/checks/stored and /api/checks/series."""
    router = APIRouter(prefix="/api/checks", tags=["health"])

    @router.get("", responses=describe_refusals())
    def checks(_: Engineer) -> list[CheckOut]:
        """The newest finding of every check since the start."""
        return [CheckOut.from_state(state) for state in context.live_state.list_checks()]

    @router.get("/stored", responses=describe_refusals(503))
    def stored_checks(_: Engineer) -> list[CheckKeyOut]:
        """All checks and cameras that have a series in the history."""
        with map_history_errors():
            keys = context.history.checks()
        return [CheckKeyOut(check=key.check, subject=key.subject, unit=key.unit) for key in keys]

    @router.get("/series", responses=describe_refusals(404, 503))
    def check_series(
        _: Engineer,
        check: CheckName,
        since_ms: WallMs,
        until_ms: WallMs,
        subject: Subject = "",
        points: Annotated[int, Query(ge=2, le=2000)] = 300,
    ) -> CheckSeriesOut:
        """The findings of one check from ``since_ms`` to before ``until_ms`` in at most ``points`` intervals."""
        check_period(since_ms, until_ms)
        with map_history_errors():
            if all((key.check, key.subject) != (check, subject) for key in context.history.checks()):
                raise HTTPException(404, "that check has no series")
            series = context.history.finding_series(
                check, subject, since_ms * MS_NS, until_ms * MS_NS, points
            )
        return CheckSeriesOut.from_series(series)

    return router


def _to_json_numbers(values: NDArray[np.floating]) -> tuple[float | None, ...]:
    """Return the values with six significant digits, None where not finite."""
    return tuple(float(f"{value:.6g}") if np.isfinite(value) else None for value in values)


def make_images_router(context: AppContext) -> APIRouter:
    """Return the route POST /api/images/learn."""
    router = APIRouter(prefix="/api/images", tags=["health"])

    @router.post("/learn", responses=describe_refusals(409, 503))
    def learn_images(user: Annotated[User, Depends(require_role("engineer"))]) -> Done:
        """Forget what the cameras normally show; it is learned from the next sound frames."""
        try:
            is_done = context.controls.learn_images(user.name)
        except OutputError as error:
            raise HTTPException(503, str(error)) from error
        if not is_done:
            raise HTTPException(409, "nothing is learned of the images: [health] learning is off")
        return Done(by=user.name)

    return router


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


def make_zero_router(context: AppContext) -> APIRouter:
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
