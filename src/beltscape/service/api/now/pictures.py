"""The endpoint of the cameras' last images."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Depends, HTTPException, Response

from beltscape.service.access import User, require_role
from beltscape.service.api.common import AppContext, CameraName, describe_refusals
from beltscape.service.view_models.picture import MEDIA_TYPE


def make_router(context: AppContext) -> APIRouter:
    """Return the route GET /api/cameras/{name}/picture."""
    router = APIRouter(prefix="/api", tags=["now"])

    @router.get(
        "/cameras/{name}/picture",
        response_class=Response,
        responses=describe_refusals(404) | {200: {"content": {MEDIA_TYPE: {}}, "description": "WebP"}},
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
        return Response(image.data, media_type=MEDIA_TYPE, headers=headers)

    return router
