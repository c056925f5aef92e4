"""Actions on the alarms of a simulated plant."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

from beltscape.core.alarms import Alarm, Suppression
from beltscape.core.errors import InputError


class SimulatedAlarmControls:
    """See core.alarms.AlarmControls: hides the alarms of a dictionary and sends them."""

    shelving_max_min = 480.0

    def __init__(self, alarms: dict[str, Alarm], send: Callable[[], None]) -> None:
        self._alarms, self._send = alarms, send
        self.texts: dict[str, dict[str, dict[str, str]]] = {}

    @property
    def own_texts(self) -> Mapping[str, Mapping[str, Mapping[str, str]]]:
        return self.texts

    def shelve(self, alarm: str, reason: str, minutes: float, by: str) -> None:
        if minutes > self.shelving_max_min:
            raise InputError(f"{minutes:g} min: longer than [alarms.shelving] max_min = 480")
        now_ns = time.time_ns()
        self._hide(alarm, Suppression("shelved", reason, by, now_ns, now_ns + round(minutes * 60e9)))

    def take_out_of_service(self, alarm: str, reason: str, by: str) -> None:
        self._hide(alarm, Suppression("out_of_service", reason, by, time.time_ns()))

    def return_to_service(self, alarm: str, by: str) -> None:
        present = self._alarms[alarm]
        if present.suppression is None:
            raise InputError(f"{alarm}: is neither shelved nor out of service")
        since_ns = None if present.hidden_state == "clear" else time.time_ns()
        self._put(
            replace(
                present, state=present.hidden_state, hidden_state="clear", suppression=None, since_ns=since_ns
            )
        )

    def reset(self, alarm: str, by: str) -> None:
        if self._alarms[alarm].state != "latched":
            raise InputError(f"{alarm}: has not latched, or is not acknowledged yet")
        self._put(replace(self._alarms[alarm], state="clear", since_ns=None, by=""))

    def _hide(self, name: str, suppression: Suppression) -> None:
        alarm = self._alarms[name]
        state = alarm.state if alarm.suppression is None else alarm.hidden_state
        self._put(
            replace(alarm, state="clear", hidden_state=state, since_ns=None, by="", suppression=suppression)
        )

    def _put(self, alarm: Alarm) -> None:
        self._alarms[alarm.name] = alarm
        self._send()
