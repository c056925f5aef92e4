"""The static files of the operator's page."""

from __future__ import annotations

import mimetypes
from pathlib import Path

from starlette.responses import Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

FOLDER = Path(__file__).parent / "page"

# the system's own table may lack these types or differ
for _ending, _kind in ((".js", "text/javascript"), (".woff2", "font/woff2"), (".json", "application/json")):
    mimetypes.add_type(_kind, _ending)


class _RevalidatedFiles(StaticFiles):
    """Static files that a browser revalidates each time, so that a new version is used at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


def make_static_files() -> StaticFiles:
    """Return the application that serves the folder, and the libraries that other pages use too."""
    return _RevalidatedFiles(directory=FOLDER, packages=[("beltscape", "data/web")])
