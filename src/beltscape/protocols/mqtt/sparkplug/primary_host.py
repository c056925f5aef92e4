"""The primary host: data wait at the belt while it is offline (specification, §5.4 and §5.13)."""

from __future__ import annotations

import json
from collections import deque
from time import monotonic

from beltscape.core.type_guards import is_dict

_NOTICED_S = 60.0
"""Time within which a broker notices that a host is gone: 1.5 times its keep-alive. Chosen: hosts have 30 s."""


class PrimaryHost:
    """State of the host: online or not, and the records that it may have missed before its death was noticed."""

    def __init__(self, name: str) -> None:
        """``name``: the host's identifier; empty: there is no primary host, and data never wait."""
        self.topics = (f"spBv1.0/STATE/{name}", f"STATE/{name}") if name else ()
        self.is_online = not name
        self.was_lost = False
        """Whether it was online and is not any more."""
        self._timestamp = -1.0
        self._published: deque[tuple[float, int]] = deque()

    def handle(self, topic: str, data: bytes) -> None:
        """Take a state: JSON {"online", "timestamp"}, or ONLINE and OFFLINE as in version 2.2; others are ignored."""
        if topic not in self.topics:
            return
        text = data[:1000].decode("utf-8", "replace").strip()
        if text in ("ONLINE", "OFFLINE"):
            self._set(is_online=text == "ONLINE")
            return
        try:
            state: object = json.loads(text)
        except ValueError:
            return
        if not is_dict(state) or not isinstance(state.get("online"), bool):
            return
        timestamp = state.get("timestamp")
        if not isinstance(timestamp, int | float) or timestamp < self._timestamp:
            return  # the death of an earlier session, which the broker sends late
        self._timestamp = timestamp
        self._set(is_online=state["online"] is True)

    def _set(self, *, is_online: bool) -> None:
        self.was_lost = self.was_lost or (self.is_online and not is_online)
        self.is_online = is_online

    def note_published(self, before: int) -> None:
        """Note that the records behind number ``before`` were published now."""
        now_s = monotonic()
        self._published.append((now_s, before))
        while self._published[0][0] < now_s - _NOTICED_S:
            self._published.popleft()

    @property
    def missed_after(self) -> int | None:
        """Return the number behind which the host may have missed records; None: it has missed none."""
        return self._published[0][1] if self.was_lost and self._published else None
