"""A reverse proxy as the manual has it: it reads nginx's ``location`` blocks and passes requests on."""

from __future__ import annotations

import asyncio
import re
import threading
from contextlib import suppress
from dataclasses import dataclass
from urllib.parse import urlsplit

_KNOWN = {"proxy_pass", "proxy_http_version", "proxy_set_header"}


@dataclass(frozen=True, slots=True)
class Location:
    """One ``location`` block."""

    path: str
    target: str
    headers: dict[str, str]
    """Set on requests that are passed on, in lower case, with nginx's variables."""


def read_locations(text: str) -> list[Location]:
    """Return the blocks of an nginx configuration; ValueError for a directive that is not known."""
    text = re.sub(r"#[^\n]*", "", text)
    found = []
    for path, body in re.findall(r"location\s+(\S+)\s*\{([^}]*)\}", text):
        lines = [line.split(None, 2) for line in body.split(";") if line.strip()]
        unknown = {line[0] for line in lines} - _KNOWN
        if unknown:
            raise ValueError(f"no rule for {sorted(unknown)}")
        target = next(line[1] for line in lines if line[0] == "proxy_pass")
        headers = {line[1].lower(): line[2].strip() for line in lines if line[0] == "proxy_set_header"}
        found.append(Location(path, target, headers))
    if not found:
        raise ValueError("no location")
    return found


class Proxy:
    """Serves locations on a free port of this machine, in a thread, until it is closed."""

    def __init__(self, locations: list[Location]) -> None:
        self._locations = locations
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, daemon=True)
        self._thread.start()
        starting = asyncio.start_server(self._serve, "127.0.0.1", 0)
        self._server = asyncio.run_coroutine_threadsafe(starting, self._loop).result(10)
        self.address = f"http://127.0.0.1:{self._server.sockets[0].getsockname()[1]}"

    def close(self) -> None:
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result(10)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(10)
        self._loop.close()

    async def _stop(self) -> None:
        self._server.close()
        running = asyncio.all_tasks() - {asyncio.current_task()}
        for task in running:
            task.cancel()
        await asyncio.gather(*running, return_exceptions=True)
        await asyncio.sleep(0)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = (await reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")[:-2]
            method, path, version = head[0].split(" ")
            place = next((one for one in self._locations if path.startswith(one.path)), None)
            if place is None:
                writer.write(
                    b"HTTP/1.1 404 Not Found\r\nContent-Length: 7\r\nConnection: close\r\n\r\nnothing"
                )
                await writer.drain()
                return
            headers = {key.lower(): value for key, value in (line.split(": ", 1) for line in head[1:])}
            target = urlsplit(place.target)
            own = {name: _fill(value, headers, writer) for name, value in place.headers.items()}
            if headers.get("connection", "").lower() != "upgrade" or own.get("connection") == "":
                own["connection"] = "close"
            headers = {name: value for name, value in {**headers, **own}.items() if value}
            lines = [f"{method} {target.path}{path[len(place.path) :]} {version}"]
            lines += [f"{name}: {value}" for name, value in headers.items()]
            above = await asyncio.open_connection(target.hostname, target.port)
            above[1].write("\r\n".join([*lines, "", ""]).encode("latin-1"))
            await asyncio.gather(_pipe(reader, above[1]), _pipe(above[0], writer))
        except (OSError, asyncio.IncompleteReadError):
            pass
        finally:
            writer.close()
            with suppress(OSError):
                await writer.wait_closed()


async def _pipe(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    try:
        while piece := await reader.read(65_536):
            writer.write(piece)
            await writer.drain()
    except OSError:
        pass
    finally:
        writer.close()


def _fill(value: str, headers: dict[str, str], writer: asyncio.StreamWriter) -> str:
    """Return a value with nginx's variables filled in."""

    def fill(match: re.Match[str]) -> str:
        name = match[1]
        if name.startswith("http_"):
            return headers.get(name[5:].replace("_", "-"), "")
        return {"remote_addr": writer.get_extra_info("peername")[0], "scheme": "http"}[name]

    return re.sub(r"\$(\w+)", fill, value)
