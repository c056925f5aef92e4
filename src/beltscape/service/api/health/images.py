"""Endpoint for engineers: what sound images show is learned anew, after cleaning or work at lenses and lights."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException

from beltscape.core.errors import OutputError
from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, describe_refusals
from beltscape.service.api.controls import Done


def make_router(context: AppContext) -> APIRouter:
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
