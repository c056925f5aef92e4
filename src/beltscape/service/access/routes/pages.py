"""The pages /login, /setup and /account. Texts, colours and fonts come from the operator's page."""

from __future__ import annotations

from pathlib import Path

from fastapi import FastAPI
from fastapi.responses import FileResponse
from starlette.staticfiles import StaticFiles

FOLDER = Path(__file__).parents[1] / "page"
PAGES = ("login", "setup", "account")


def add_pages(app: FastAPI) -> None:
    """Serve the pages, and their files at /access/."""
    app.mount("/access", StaticFiles(directory=FOLDER), name="access-page")
    for name in PAGES:
        _add_page(app, name)


def _add_page(app: FastAPI, name: str) -> None:
    def page() -> FileResponse:
        return FileResponse(FOLDER / f"{name}.html")

    app.add_api_route(f"/{name}", page, methods=["GET"], include_in_schema=False, name=f"{name}-page")
