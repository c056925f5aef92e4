"""Shared parts of the endpoints: parameter types, response models, refusals, the application context."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Any

from fastapi import HTTPException, Path, Query
from pydantic import BaseModel, ConfigDict

from beltscape.core.interfaces import Controls
from beltscape.service.live_state import LiveState
from beltscape.service.production.serving import ServedProduction
from beltscape.service.settings import WebSettings
from beltscape.sinks.historian import Historian

LAST_MS = 4_102_444_800_000
"""Latest time of a request, ms: the beginning of 2100."""

WallMs = Annotated[int, Query(ge=0, le=LAST_MS, description="System clock, ms since 1970 UTC")]
CameraName = Annotated[str, Path(min_length=1, max_length=64, description="Name of a camera")]
AlarmName = Annotated[str, Path(min_length=1, max_length=160, description="Name of an alarm")]


@dataclass(frozen=True, slots=True)
class AppContext:
    """Objects that all endpoints share: live state, history, controls and settings."""

    live_state: LiveState
    history: Historian
    controls: Controls
    production: ServedProduction | None = None
    """Products, batches, shifts and reports; None: there are none."""

    @property
    def settings(self) -> WebSettings:
        """The page's settings, which may change while it is served."""
        return self.live_state.settings


class ResponseModel(BaseModel):
    """Base of all response models; undeclared fields are an error."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class Problem(ResponseModel):
    """The reason of a refusal, in one line."""

    detail: str


_REFUSAL_REASONS = {
    401: "Not signed in",
    403: "Signed in, but the role does not allow it",
    404: "There is no such thing",
    409: "Nothing was changed: it was so already, or is not possible now",
    429: "Too many requests",
    503: "The history cannot be read at the moment",
}


def describe_refusals(*codes: int) -> dict[int | str, dict[str, Any]]:
    """Return OpenAPI descriptions of the refusals ``codes``, with those that every endpoint has."""
    return {
        code: {"model": Problem, "description": _REFUSAL_REASONS[code]} for code in (401, 403, 429, *codes)
    }


def check_period(since_ms: int, until_ms: int) -> None:
    """Raise HTTPException 422 if a period ends before it begins."""
    if until_ms < since_ms:
        detail = [{"loc": ["query", "until_ms"], "msg": "lies before since_ms", "type": "value_error"}]
        raise HTTPException(422, detail)
