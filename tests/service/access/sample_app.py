"""A small application with access control, and a browser that calls it."""

from __future__ import annotations

import asyncio
from typing import Annotated, Any

import httpx
from fastapi import Depends, FastAPI, WebSocket

from beltscape.service.access import Access, User, get_socket_user, install_access, require_role
from beltscape.service.access.passwords import ScryptCost

CHEAP = ScryptCost(log2_n=4, r=8, p=1)
PASSWORD = "coal on the belt"


class Browser:
    """Keeps cookies and sends the page's token, as the page does."""

    def __init__(self, app: FastAPI, address: str = "10.0.0.1", base: str = "http://localhost") -> None:
        self.app, self.address, self.base = app, address, base
        self.cookies = httpx.Cookies()
        self.token = ""

    def __call__(self, method: str, path: str, headers: dict | None = None, **more: Any) -> httpx.Response:
        async def call() -> httpx.Response:
            transport = httpx.ASGITransport(self.app, client=(self.address, 5000))
            async with httpx.AsyncClient(
                transport=transport, base_url=self.base, cookies=self.cookies
            ) as client:
                sent = {"x-beltscape-token": self.token, **(headers or {})}
                response = await client.request(method, path, headers=sent, **more)
                self.cookies = client.cookies
                return response

        return asyncio.run(call())

    def log_in(self, name: str, password: str = PASSWORD) -> httpx.Response:
        response = self("POST", "/api/access/login", json={"name": name, "password": password})
        if response.status_code == 200:
            self.token = response.json()["token"]
        return response


async def wait_for_disconnect(websocket: WebSocket) -> None:
    while (await websocket.receive())["type"] != "websocket.disconnect":
        pass


def make_application(access: Access, **more: Any) -> FastAPI:
    """Return an application with a route for each of two roles, an export and a WebSocket."""
    app = FastAPI()

    @app.get("/look")
    def read_page(user: Annotated[User, Depends(require_role("viewer"))]) -> dict[str, str]:
        return {"name": user.name, "role": user.role}

    @app.post("/alarms/{name}/acknowledge")
    def acknowledge(name: str, user: Annotated[User, Depends(require_role("operator"))]) -> dict[str, str]:
        return {"by": user.name}

    @app.get("/api/export")
    def export(user: Annotated[User, Depends(require_role("viewer"))]) -> dict[str, str]:
        return {}

    @app.websocket("/live")
    async def live(websocket: WebSocket) -> None:
        user = get_socket_user(websocket)
        assert user is not None
        await websocket.accept()
        listening = asyncio.create_task(wait_for_disconnect(websocket))
        while not listening.done():
            await websocket.send_text(user.name)
            await asyncio.sleep(0.02)

    install_access(app, access, **more)
    return app
