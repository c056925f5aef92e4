"""The applications that serve pages, and the static files of the operator's page."""

from __future__ import annotations

import mimetypes
from dataclasses import asdict
from pathlib import Path

from fastapi import FastAPI
from starlette.responses import JSONResponse, Response
from starlette.staticfiles import StaticFiles
from starlette.types import Scope

from beltscape import __version__
from beltscape.service.settings import list_languages

FOLDER = Path(__file__).parent / "page"
_LANGUAGES = "languages.json"
"""The list of the page's languages, made from their files."""

# the system's own table may lack these types or differ
for _ending, _kind in ((".js", "text/javascript"), (".woff2", "font/woff2"), (".json", "application/json")):
    mimetypes.add_type(_kind, _ending)


def make_page_app(title: str, summary: str) -> FastAPI:
    """Return an application without routes, described at /api/openapi.json."""
    return FastAPI(
        title=title,
        version=__version__,
        summary=summary,
        openapi_url="/api/openapi.json",
        docs_url=None,  # its page would load scripts from other servers
        redoc_url=None,
        redirect_slashes=False,  # its address would lack a proxy's path
    )


class RevalidatedFiles(StaticFiles):
    """Static files that a browser revalidates each time, so that a new version is used at once."""

    async def get_response(self, path: str, scope: Scope) -> Response:
        """Return the answer to a request for a file, or the list of the languages."""
        if path == _LANGUAGES:
            response: Response = JSONResponse([asdict(language) for language in list_languages()])
        else:
            response = await super().get_response(path, scope)
        response.headers["Cache-Control"] = "no-cache"
        return response


def make_static_files() -> StaticFiles:
    """Return the application that serves the folder, and the libraries that other pages use too."""
    return RevalidatedFiles(directory=FOLDER, packages=[("beltscape", "data/web")])
