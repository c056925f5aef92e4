"""The live stream: what open pages receive over the WebSocket /api/live.

Text messages are JSON objects with a ``kind``:

state    as GET /api/state answers
flow     points for the chart: {"kind", "first", "wall_ms": [...], "m3_h": [...], "sigma": [...], "t_h": [...]}
records  the newest entries of the ledger: {"kind", "records": [{number, from_m, to_m, standing, reason}, ...]}

Binary messages begin with the length of a JSON header (uint32, little endian), the header, blanks up to a multiple
of 4 bytes, then uint16 heights, little endian, as ``encode_heights`` returns them:

belt     rows of the belt's surface: {"kind", "epoch", "first", "rows", "columns", "cell_mm", "x_mm": [first, last],
         "step_mm", "offset_mm"}
section  the newest cross-section: {"kind", "number", "belt_m": [from, to], "x_mm": [...], "step_mm", "offset_mm"}

Nothing is queued: a page that reads slowly receives the newest data when it can take more. A state is sent at least
once a second, so a page that receives nothing for some seconds can conclude that the connection is lost.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite

import numpy as np
from fastapi import FastAPI, WebSocket, WebSocketDisconnect
from numpy.typing import NDArray

from beltscape.core.ledger import BeltRecord
from beltscape.service.access import get_socket_user
from beltscape.service.api.common import AppContext
from beltscape.service.api.state import StateOut
from beltscape.service.belt_surface import OFFSET_MM, STEP_MM, BeltRows, encode_heights
from beltscape.service.live_state import LiveState
from beltscape.service.view_models import FlowPoint

PATH = "/api/live"
_SEND_S = 20.0
"""A page that has not taken a message after this time is disconnected, so that its queue stays short. Chosen."""
_ROWS_A_MESSAGE = 512
"""Rows of the belt in one message; it bounds its size."""


@dataclass(slots=True)
class SentState:
    """State of the messages that were sent to one page."""

    points: int = 0
    record: int = -1
    belt: tuple[int, int] | None = None
    state: str = ""
    silent_calls: int = 0


def collect_messages(live_state: LiveState, sent: SentState, max_silent_calls: int) -> list[str | bytes]:
    """Return the messages that bring a page up to date, and record them in ``sent``.

    An unchanged state is sent again only after ``max_silent_calls`` calls without one.
    """
    messages: list[str | bytes] = []
    state = StateOut.from_snapshot(live_state.take_snapshot()).model_dump_json()
    sent.silent_calls += 1
    if _without_clock(state) != sent.state or sent.silent_calls >= max_silent_calls:
        sent.state, sent.silent_calls = _without_clock(state), 0
        messages.append(f'{{"kind":"state",{state[1:]}')
    count, points = live_state.list_points(sent.points)
    if points:
        messages.append(_flow_message(count - len(points), points))
        sent.points = count
    records = live_state.list_records(sent.record)
    if records:
        messages.append(_records_message(records))
        sent.record = records[-1].number
        messages.extend(_section_message(records))
    mark, rows = live_state.get_belt(sent.belt)
    if rows is not None:
        messages.extend(_belt_messages(rows))
    sent.belt = mark
    return messages


def _without_clock(state: str) -> str:
    """Return the state without the values that change with time alone."""
    parts = json.loads(state)
    parts["wall_ms"] = parts["health_age_s"] = parts["frames"]["age_s"] = parts["flow"]["age_s"] = parts[
        "stale_s"
    ] = 0
    return json.dumps(parts)


def _round_or_none(value: float, digits: int) -> float | None:
    return round(value, digits) if isfinite(value) else None


def _flow_message(first: int, points: list[FlowPoint]) -> str:
    message = {
        "kind": "flow",
        "first": first,
        "wall_ms": [point.wall_ms for point in points],
        "m3_h": [_round_or_none(point.flow.volume_m3_h, 3) for point in points],
        "sigma": [_round_or_none(point.flow.sigma_m3_h, 3) for point in points],
        "t_h": [_round_or_none(point.flow.mass_t_h, 3) for point in points],
    }
    return json.dumps(message, separators=(",", ":"))


def _records_message(records: list[BeltRecord]) -> str:
    entries = [
        {
            "number": record.number,
            "from_m": round(record.belt_mm[0] * 1e-3, 3),
            "to_m": round(record.belt_mm[1] * 1e-3, 3),
            "standing": record.standing,
            "reason": record.reason,
        }
        for record in records
    ]
    return json.dumps({"kind": "records", "records": entries}, separators=(",", ":"))


def _section_message(records: list[BeltRecord]) -> list[bytes]:
    """Return the message of the newest cross-section, if any."""
    newest = next((record for record in reversed(records) if record.section is not None), None)
    if newest is None or newest.section is None:
        return []
    section = newest.section
    header = {
        "kind": "section",
        "number": newest.number,
        "belt_m": [round(mm * 1e-3, 3) for mm in newest.belt_mm],
        "x_mm": [round(float(x), 2) for x in section.x_mm],
        "step_mm": STEP_MM,
        "offset_mm": OFFSET_MM,
    }
    return [pack_binary(header, encode_heights(section.height_mm, np.isfinite(section.height_mm)))]


def _belt_messages(rows: BeltRows) -> list[bytes]:
    """Return the rows in messages that are small enough for a slow connection."""
    messages: list[bytes] = []
    for start in range(0, rows.counts.shape[0], _ROWS_A_MESSAGE):
        counts = rows.counts[start : start + _ROWS_A_MESSAGE]
        header = {
            "kind": "belt",
            "epoch": rows.epoch,
            "first": rows.first + start,
            "rows": counts.shape[0],
            "columns": counts.shape[1],
            "cell_mm": rows.cell_mm,
            "x_mm": [float(rows.x_mm[0]), float(rows.x_mm[-1])],
            "step_mm": STEP_MM,
            "offset_mm": OFFSET_MM,
        }
        messages.append(pack_binary(header, counts))
    return messages


def pack_binary(header: Mapping[str, object], counts: NDArray[np.uint16]) -> bytes:
    """Return one binary message."""
    head = json.dumps(header, separators=(",", ":")).encode()
    head += b" " * (-len(head) % 4)
    return len(head).to_bytes(4, "little") + head + counts.astype("<u2").tobytes()


def add_live_route(app: FastAPI, context: AppContext) -> None:
    """Add the WebSocket route to ``app``."""

    @app.websocket(PATH)
    async def live(socket: WebSocket) -> None:
        user = get_socket_user(socket)
        if user is None or not user.has_role("viewer"):
            await socket.close(1008)
            return
        await socket.accept()
        tasks = {
            asyncio.create_task(_send_updates(socket, context)),
            asyncio.create_task(_wait_for_disconnect(socket)),
        }
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            for result in await asyncio.gather(*tasks, return_exceptions=True):
                if isinstance(result, Exception) and not isinstance(result, _DISCONNECT_ERRORS):
                    raise result


_DISCONNECT_ERRORS = (WebSocketDisconnect, TimeoutError, RuntimeError)
"""Errors of sending to a page that has closed or reads nothing."""


async def _send_updates(socket: WebSocket, context: AppContext) -> None:
    """Send one page its updates until the task is cancelled."""
    rate_hz = context.settings.page_rate_hz
    sent = SentState()
    while True:
        for message in await asyncio.to_thread(
            collect_messages, context.live_state, sent, max(round(rate_hz), 1)
        ):
            sending = socket.send_text(message) if isinstance(message, str) else socket.send_bytes(message)
            await asyncio.wait_for(sending, _SEND_S)
        await asyncio.sleep(1 / rate_hz)


async def _wait_for_disconnect(socket: WebSocket) -> None:
    """Return when the page has disconnected; its messages are ignored."""
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass
