"""The web application of a commissioning: its page, its interface for engineers, and its server.

Users are those of the plant's data folder, so that the first engineer of the commissioning is one of the plant.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator
from contextlib import contextmanager
from pathlib import Path
from threading import Event
from typing import Annotated, Any

from fastapi import Body, Depends, FastAPI, HTTPException
from fastapi import Path as InPath
from fastapi.responses import FileResponse, Response
from pydantic import BaseModel, ConfigDict

from beltscape import __version__
from beltscape.commissioning.session import CommissionSession, ViewAction, find_file
from beltscape.commissioning.state import CommissionState
from beltscape.core.errors import BeltscapeError
from beltscape.core.system_calls import notify
from beltscape.files.json_text import to_plain
from beltscape.service.access import Access, User, install_access, require_role
from beltscape.service.data_rights import restrict_rights
from beltscape.service.hosting import RunningServer, check_listening, serve
from beltscape.service.settings import PageSettings
from beltscape.service.static import RevalidatedFiles, make_page_app, make_static_files

FOLDER = Path(__file__).parent / "page"
Engineer = Annotated[User, Depends(require_role("engineer"))]
Viewer = Annotated[User, Depends(require_role("viewer"))]
_REPORT_POLICY = (
    "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; img-src data: blob:; font-src data:; "
    "frame-ancestors 'none'; sandbox allow-scripts"
)
"""A report is complete in itself; its script draws the rig, and the sandbox keeps it from everything of the page."""
_LOG = logging.getLogger("beltscape.commission")


class SettingChanges(BaseModel):
    """Settings to change, by their keys."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    changes: dict[str, Any]


def create_commission_app(session: CommissionSession, access: Access, language: str) -> FastAPI:
    """Return the application; described at /api/openapi.json."""
    app = make_page_app("Beltscape commissioning", "From bare cameras to a certificate, in steps.")
    app.mount("/page", make_static_files(), name="page")
    app.mount("/commission", RevalidatedFiles(directory=FOLDER), name="commission")

    @app.get("/", include_in_schema=False)
    def index() -> FileResponse:
        """The page."""
        return FileResponse(FOLDER / "index.html")

    @app.get("/api/page", tags=["commission"])
    def page(user: Viewer) -> dict[str, Any]:
        """The signed-in user and the settings of the page."""
        return {
            "plant": session.state.settings.plant,
            "language": language,
            "version": __version__,
            "user": user.name,
            "role": user.role,
        }

    _add_steps(app, session)
    _add_pictures(app, session)
    install_access(app, access, public=("/commission/",))
    return app


def _add_steps(app: FastAPI, session: CommissionSession) -> None:
    @app.get("/api/commission", tags=["commission"])
    def state(_: Engineer) -> dict[str, Any]:
        """Steps, settings, what runs, and the views of the board."""
        return to_plain(session.take_snapshot())

    @app.post("/api/commission/settings", tags=["commission"])
    def settings(body: SettingChanges, _: Engineer) -> dict[str, Any]:
        """Change settings."""
        return _answer(session, lambda: session.change_settings(body.changes))

    @app.post("/api/commission/run/{step}", tags=["commission"])
    def run_step(step: Annotated[str, InPath(max_length=20)], _: Engineer) -> dict[str, Any]:
        """Begin a step."""
        return _answer(session, lambda: session.start(step))

    @app.post("/api/commission/cancel", tags=["commission"])
    def cancel(_: Engineer) -> dict[str, Any]:
        """End the step that runs; it stays open."""
        return _answer(session, session.cancel)

    @app.post("/api/commission/views", tags=["commission"])
    def views(action: Annotated[ViewAction, Body(embed=True)], _: Engineer) -> dict[str, Any]:
        """Start or stop taking views of the board, take the present one, or begin anew."""
        return _answer(session, lambda: session.handle_views(action))


def _add_pictures(app: FastAPI, session: CommissionSession) -> None:
    @app.get("/api/commission/found", tags=["commission"])
    def found(_: Engineer) -> list[dict[str, Any]]:
        """The cameras that answer on the network."""
        from dataclasses import asdict

        from beltscape.sources.genicam.aravis import find_cameras

        try:
            return [asdict(one) for one in find_cameras()]
        except BeltscapeError as error:
            raise HTTPException(409, str(error)) from error

    @app.post("/api/commission/live", tags=["commission"])
    def live(is_open: Annotated[bool, Body(embed=True)], _: Engineer) -> dict[str, Any]:
        """Open or close the cameras for pictures."""
        return _answer(session, session.open_cameras if is_open else session.close_cameras)

    @app.get("/api/commission/optics", tags=["commission"])
    def optics(_: Engineer) -> dict[str, Any]:
        """Histogram and sharpness of every camera's newest picture."""
        return to_plain(session.assess_optics())

    @app.get("/api/commission/pictures/{camera}", tags=["commission"], response_class=Response)
    def picture(camera: Annotated[str, InPath(max_length=64)], _: Engineer) -> Response:
        """A camera's newest picture as JPEG."""
        data = session.encode_picture(camera)
        if data is None:
            raise HTTPException(404, "there is no picture of this camera now")
        return Response(data, media_type="image/jpeg")

    @app.get("/api/commission/files/{name:path}", tags=["commission"], response_class=FileResponse)
    def file(name: Annotated[str, InPath(max_length=200)], _: Engineer) -> FileResponse:
        """A result of a step: a report, a picture, the board to print, a certificate."""
        path = find_file(session.state.folder, name)
        if path is None:
            raise HTTPException(404, "there is no such result")
        headers = {"content-security-policy": _REPORT_POLICY} if path.suffix == ".html" else None
        return FileResponse(path, filename=path.name, content_disposition_type="inline", headers=headers)


def _answer(session: CommissionSession, act: Callable[[], None]) -> dict[str, Any]:
    """Return the new state; what is refused is answered with 409 and the one line that says why."""
    try:
        act()
    except BeltscapeError as error:
        raise HTTPException(409, str(error)) from error
    return to_plain(session.take_snapshot())


@contextmanager
def open_commission(
    state: CommissionState, port: int, language: str
) -> Generator[tuple[RunningServer, CommissionSession, Access]]:
    """Serve the page of a commissioning until the end of the context."""
    settings = PageSettings(port=port, language=language)
    check_listening(settings)
    data = state.folder / "data"
    data.mkdir(parents=True, exist_ok=True)
    session, access = CommissionSession(state), Access(data, settings.access)
    try:
        server = serve(create_commission_app(session, access, language), settings)
        try:
            yield server, session, access
        finally:
            session.close()
            server.close()
    finally:
        access.close()


def serve_commission(state: CommissionState, port: int, language: str, stop: Event) -> None:
    """Serve the page until ``stop`` is set.

    Raises
    ------
    SettingsError, OutputError
        With one line that names the fault and the fix.
    """
    with (
        restrict_rights(state.folder / "data"),
        open_commission(state, port, language) as (server, _, _access),
    ):
        notify("READY=1")
        _LOG.info("commissioning in %s; the page is at %s", state.folder, server.address)
        stop.wait()
        notify("STOPPING=1")
