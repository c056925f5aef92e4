"""An observer that writes the events of a run to the log, for a terminal or systemd's journal."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from time import monotonic

from beltscape.core.alarms import Alarm
from beltscape.core.events import BeltStretch, CameraHealth, FrameEvent, Maintenance
from beltscape.core.findings import Finding
from beltscape.core.ledger import BeltRecord, Totals

_LOG = logging.getLogger("beltscape")
_EVERY_S = 60.0
"""Period of the line in the log: 1440 lines a day."""
_LEVEL = {"info": logging.INFO, "warning": logging.WARNING, "critical": logging.ERROR}


class LogObserver:
    """Logs messages and changes of cameras and alarms at once, the totals once a minute."""

    def __init__(self) -> None:
        self._states: dict[str, str] = {}
        self._alarms: dict[str, str] = {}
        self._logged_s = monotonic()

    def on_frame(self, event: FrameEvent) -> None:
        """Ignore single frame sets."""

    def on_measured(self, records: Sequence[BeltRecord]) -> None:
        """Ignore what is not on disk yet."""

    def on_records(self, records: Sequence[BeltRecord], totals: Totals) -> None:  # noqa: ARG002
        """Log the totals, once a minute."""
        if monotonic() - self._logged_s < _EVERY_S:
            return
        self._logged_s = monotonic()
        _LOG.info(
            "%.3f m³ (σ %.3f) on %.1f m of belt: %.1f m valid, %.1f m degraded, %.1f m missing",
            totals.volume_mm3 * 1e-9,
            totals.sigma_mm3 * 1e-9,
            totals.length_mm * 1e-3,
            totals.valid_mm * 1e-3,
            totals.degraded_mm * 1e-3,
            totals.missing_mm * 1e-3,
        )

    def on_surface(self, stretch: BeltStretch) -> None:
        """Ignore the belt's surface."""

    def on_health(self, cameras: Mapping[str, CameraHealth]) -> None:
        """Log the cameras whose state has changed."""
        for name, camera in cameras.items():
            if self._states.get(name) != camera.state:
                level = logging.INFO if camera.state in ("ok", "waiting") else logging.WARNING
                _LOG.log(
                    level, "%s: %s%s", name, camera.state, f", {camera.message}" if camera.message else ""
                )
            self._states[name] = camera.state

    def on_alarms(self, alarms: Sequence[Alarm]) -> None:
        """Log the alarms whose state has changed."""
        for alarm in alarms:
            if self._alarms.get(alarm.name, "clear") != alarm.state:
                level = _LEVEL[alarm.severity] if alarm.state == "raised" else logging.INFO
                _LOG.log(
                    level,
                    "alarm %s %s%s",
                    alarm.name,
                    alarm.state,
                    f": {alarm.detail}" if alarm.detail else "",
                )
            self._alarms[alarm.name] = alarm.state

    def on_findings(self, findings: Sequence[Finding]) -> None:
        """Ignore findings; the alarms of faults are logged."""

    def on_maintenance(self, maintenance: Maintenance | None) -> None:
        """Log begin and end of maintenance."""
        if maintenance is None:
            _LOG.info("maintenance ends; the belt is measured again")
        else:
            _LOG.info("maintenance (%s) by %s: the belt is not measured", maintenance.reason, maintenance.by)

    def on_message(self, message: str) -> None:
        """Log the message as a warning."""
        _LOG.warning("%s", message)
