"""Setting of the zero while the system runs: measured on request, confirmed, kept on the disk."""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from time import monotonic

from beltscape.core.alarm_catalogue import ZERO_DRIFT, ZERO_SHIFT, ZERO_TILT
from beltscape.core.depth import DepthMap
from beltscape.core.errors import MeasureError
from beltscape.core.events import ZeroProposal
from beltscape.core.findings import Finding
from beltscape.core.progress import Reporter
from beltscape.core.translatable_message import make_message
from beltscape.files.atomic import keep_state
from beltscape.files.belt_json import format_belt, read_belt, read_zero_settings
from beltscape.health.belt.zero_setting import ZeroSetting, zero_offset
from beltscape.health.settings import BeltLimits
from beltscape.measure.belt.reference import EmptyBeltReference, make_reference
from beltscape.pipeline.live.learned_images import read_optional_file
from beltscape.pipeline.measuring.zero import make_zero_document

FILE = "zero.json"
"""The belt.json with the zero that was set; it is beside the history."""
_FRAMES = 5
"""Frames from which the zero is measured: they must agree."""
_PATIENCE_S = 20.0
"""Longest time in which they must come."""
_VALID_S = 300.0
"""Time in which a measured zero can be confirmed; the belt may be loaded again afterwards."""
_ZERO_CHECKS = frozenset({ZERO_SHIFT, ZERO_DRIFT, ZERO_TILT})
"""Checks whose faults setting the zero mends; a frame with any other fault is not used."""


class ZeroControl:
    """Measures the zero on the empty running belt and sets it; measured and confirmed by any thread.

    The motion is always measured against the learned belt, so that its limit bounds the sum of all settings.
    """

    def __init__(
        self,
        learned: EmptyBeltReference,
        limits: BeltLimits,
        path: Path | None = None,
        digest: str = "",
        *,
        patience_s: float = _PATIENCE_S,
        monotonic_s: Callable[[], float] = monotonic,
    ) -> None:
        """``path`` is the file to keep the zero in, None: it is not kept; ``digest`` is that of the learned belt."""
        self._learned, self._limits, self._path, self._digest = learned, limits, path, digest
        self._patience_s, self._monotonic_s = patience_s, monotonic_s
        self._changed = threading.Condition()
        self._measuring = threading.Lock()
        self._depths: list[DepthMap] = []
        self._wanted = 0
        """Number of depth maps that are still to be collected."""
        self._number = 0
        self._measured: tuple[int, float, ZeroSetting] | None = None
        """Number, monotonic clock and result of the last measurement."""
        self._reference: EmptyBeltReference | None = None
        """The reference to be used from the next frame on."""

    def add(self, depth: DepthMap | None, findings: Sequence[Finding]) -> None:
        """Take over the depth map of a frame while the zero is measured."""
        if depth is None or not self._wanted:
            return
        if any(one.effect != "none" and one.check not in _ZERO_CHECKS for one in findings):
            return
        with self._changed:
            if self._wanted:
                self._depths.append(depth)
                self._wanted -= 1
                self._changed.notify_all()

    def measure(self) -> ZeroProposal:
        """Return the motion of the belt since it was learned, from the next frames of the empty running belt.

        Raises
        ------
        MeasureError
            With one line, if it is being measured already, the frames do not come, the belt is not empty, or the
            motion exceeds the limit.
        """
        if not self._measuring.acquire(blocking=False):
            raise MeasureError(make_message("zero_set_busy", subject="zero"))
        try:
            setting = zero_offset(self._collect(), self._learned, self._limits)
        finally:
            self._measuring.release()
        self._number += 1
        self._measured = self._number, self._monotonic_s(), setting
        return ZeroProposal(
            self._number,
            setting.offset_mm,
            setting.sigma_mm,
            setting.tilt_mm,
            setting.frames,
            self._limits.set_limit_mm,
        )

    def set(self, number: int, by: str) -> ZeroSetting | None:
        """Set the zero to measurement ``number``; None if it is not the last one, too old, or set already.

        Raises
        ------
        OutputError
            When it cannot be kept; then nothing is set.
        """
        with self._changed:
            measured = self._measured
            if measured is None or measured[0] != number or self._monotonic_s() - measured[1] > _VALID_S:
                return None
            setting = measured[2]
            self._keep(setting, by)
            self._measured, self._reference = None, setting.reference
            return setting

    def pop_reference(self) -> EmptyBeltReference | None:
        """Return the reference that was set since the last call; None without one."""
        if self._reference is None:
            return None
        with self._changed:
            reference, self._reference = self._reference, None
            return reference

    def _collect(self) -> list[DepthMap]:
        with self._changed:
            self._depths, self._wanted = [], _FRAMES
            self._changed.wait_for(lambda: not self._wanted, self._patience_s)
            depths, self._depths, self._wanted = self._depths, [], 0
        if len(depths) < _FRAMES:
            raise MeasureError(
                make_message("zero_set_no_frames", subject="zero", frames=len(depths), needed=_FRAMES)
            )
        return depths

    def _keep(self, setting: ZeroSetting, by: str) -> None:
        if self._path is None:
            return
        at = datetime.now(UTC).isoformat(timespec="seconds")
        entry = {"at": at, "by": by, **make_zero_document(setting), "learned_sha256": self._digest}
        before = read_zero_settings(self._path) if self._path.is_file() else []
        text = format_belt(setting.reference.belt, self._learned.camera, [*before, entry])
        keep_state(self._path, text.encode())


def read_zero(path: Path, learned: EmptyBeltReference, digest: str, reporter: Reporter) -> EmptyBeltReference:
    """Return the reference with the zero that an earlier run set; ``learned`` without one.

    A zero of another learned belt, whose ``digest`` differs, and a damaged file are named and not used.
    """
    fix = "the zero of the learned empty belt is used; set the zero again"
    found = read_optional_file(path, lambda: (read_belt(path)[0], read_zero_settings(path)), fix, reporter)
    if found is None:
        return learned
    belt, settings = found
    if not settings or settings[-1].get("learned_sha256") != digest:
        reporter.warn(f"{path}: it was set for another empty belt; {fix}")
        return learned
    return make_reference(belt, learned.camera, learned.cell_mm)
