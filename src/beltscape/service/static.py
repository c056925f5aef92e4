"""The operator's page: static files, served as they lie here."""

from __future__ import annotations

import mimetypes
from pathlib import Path

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

FOLDER = Path(__file__).parent / "page"

# the system's own table may lack these, or say otherwise
for _ending, _kind in ((".js", "text/javascript"), (".woff2", "font/woff2"), (".json", "application/json")):
    mimetypes.add_type(_kind, _ending)


class _RevalidatedFiles(StaticFiles):
    """Files that a browser asks about again each time, so that a new version is seen at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


def make_static_files() -> StaticFiles:
    """Serves the folder."""
    return _RevalidatedFiles(directory=FOLDER)
