"""The operator's actions on a running engine: on alarms, recording, maintenance, learned images and zero."""

from __future__ import annotations

from time import time_ns

from beltscape.core.alarm_catalogue import MAINTENANCE
from beltscape.core.alarms import AlarmControls
from beltscape.core.events import ZeroProposal
from beltscape.core.translatable_message import make_event_text
from beltscape.pipeline.live.alarm_control import AlarmControl
from beltscape.pipeline.live.engine_components import EngineComponents


class OperatorControls:
    """Implements `Controls` on the components of an engine; every action is an event of the history."""

    def __init__(self, components: EngineComponents) -> None:
        self._components = components
        self._events = components.events
        recorder = components.recorder
        self._alarms = AlarmControl(
            components.board,
            components.hidden_alarms,
            self._events,
            components.observer,
            (lambda _: None) if recorder is None else recorder.keep,
            components.alarm_states,
            components.source.cameras,
        )

    @property
    def alarm_controls(self) -> AlarmControls:
        """The further actions on alarms."""
        return self._alarms

    def acknowledge(self, alarm: str, by: str) -> bool:
        """Acknowledge an alarm; return whether there was one to acknowledge."""
        return self._alarms.acknowledge(alarm, by)

    def keep_recording(self, reason: str, by: str) -> bool:
        """Keep the frames that the recording ring holds now; return whether there were any."""
        recorder = self._components.recorder
        kept = None if recorder is None else recorder.keep(reason)
        if kept is None:
            return False
        self._events.add("recording", kept.name, reason, time_ns(), by)
        return True

    def begin_maintenance(self, reason: str, minutes: float, by: str) -> bool:
        """Begin maintenance, or set its reason and end anew."""
        present = self._components.maintenance.begin(reason, minutes, by)
        values: dict[str, object] = {"action": "begin", "reason": reason, "minutes": minutes}
        self._events.add(
            MAINTENANCE, "begin", f"{reason}, for at most {minutes:g} min", time_ns(), by, values
        )
        self._components.observer.on_maintenance(present)
        return True

    def end_maintenance(self, by: str) -> bool:
        """End maintenance; return whether there was any. Without ``by`` its time is over."""
        ended = self._components.maintenance.end()
        if ended is None:
            return False
        values: dict[str, object] = {"action": "end", "reason": ended.reason}
        self._events.add(MAINTENANCE, "end", ended.reason, time_ns(), by, values)
        self._components.observer.on_maintenance(None)
        return True

    def learn_images(self, by: str) -> bool:
        """Learn anew what sound images show, after cleaning or work at lenses and lights."""
        if not self._components.learned_images.learn_anew():
            return False
        self._events.add("images", "learn", make_event_text("images_learn"), time_ns(), by)
        return True

    def measure_zero(self) -> ZeroProposal:
        """Return the empty belt's motion since it was learned, from the next frames."""
        return self._components.zero.measure()

    def set_zero(self, number: int, by: str) -> bool:
        """Set the zero to a measured one; it holds from the next frame on and over restarts."""
        setting = self._components.zero.set(number, by)
        if setting is None:
            return False
        values: dict[str, object] = {
            "value": round(setting.offset_mm, 3),
            "sigma": round(setting.sigma_mm, 3),
            "tilt": round(setting.tilt_mm, 2),
        }
        text = f"{setting.offset_mm:+.2f} ± {setting.sigma_mm:.2f} mm, tilt {setting.tilt_mm:+.2f} mm"
        self._events.add("zero", "set", text, time_ns(), by, values)
        return True
