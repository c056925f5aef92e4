"""A recorder whose folder nobody may enter for a while; prints its states as JSON. Run by test_recorder.py.

``python -m tests.sinks.recording.forbidden_folder FOLDER``; as root it becomes another user first, whom rights bind.
"""

from __future__ import annotations

import json
import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.sinks.recorder import Recorder, RecorderState
from beltscape.sinks.settings import RecordingSettings

NOBODY = 65534


def record(recorder: Recorder, start: int, until: Callable[[RecorderState], bool]) -> dict[str, object]:
    """Record until a state is reached, at most ten seconds; return the state at the end."""
    for number in range(start, start + 100):
        image = np.full((20, 30), number % 250, np.uint8)
        recorder.take(FrameSet(f"{number:06d}", {"cam0": image}, number * 100_000_000, float(number)))
        time.sleep(0.1)
        if until(recorder.state):
            break
    state = recorder.state
    return {"written": state.written, "dropped": state.dropped, "trouble": state.trouble}


def is_recording(state: RecorderState) -> bool:
    return state.written > 0 and not state.trouble


def is_paused(state: RecorderState) -> bool:
    return bool(state.trouble)


def main(folder: Path) -> None:
    """Record before, while and after the folder cannot be entered, and begin once in such a folder."""
    if os.geteuid() == 0:
        os.chown(folder, NOBODY, NOBODY)
        os.seteuid(NOBODY)
    recordings = folder / "recordings"
    recorder = Recorder(recordings, RecordingSettings(mode="all", free_gib=0))
    out = {"before": record(recorder, 0, is_recording)}
    recordings.chmod(0)
    out["forbidden"] = record(recorder, 100, is_paused)
    recordings.chmod(0o750)
    before = recorder.state.written
    out["after"] = record(recorder, 200, lambda state: is_recording(state) and state.written > before)
    recorder.close()
    (recordings / "all").chmod(0)
    recorder = Recorder(recordings, RecordingSettings(mode="all", free_gib=0))
    out["begun forbidden"] = record(recorder, 300, is_paused)
    (recordings / "all").chmod(0o750)
    out["begun after"] = record(recorder, 400, is_recording)
    recorder.close()
    captures = sorted(path.name.partition("-")[0] for path in (recordings / "all").iterdir())
    print(json.dumps({**out, "captures": captures}))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
