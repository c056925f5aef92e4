"""The recorder on a disk of 8 MiB that it fills; prints its state as JSON. Run by test_recorder.py.

Mounts the disk itself: run it in a mount namespace of its own.
"""

from __future__ import annotations

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from beltscape.core.frames import FrameSet
from beltscape.files.capture import read_capture
from beltscape.files.images import read_image
from beltscape.sinks.recorder import Recorder
from beltscape.sinks.settings import RecordingSettings


def main(folder: Path) -> None:
    """Record until it pauses, tidy up, record again."""
    folder.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", "size=8m", "tmpfs", str(folder)], check=True)
    (folder / "other").write_bytes(bytes(4 << 20))
    recorder = Recorder(folder / "recordings", RecordingSettings(mode="ring", free_gib=0, queue=2))
    image = np.random.default_rng(1).integers(0, 256, (300, 400), dtype=np.uint8)
    seen: dict[str, object] = {"trouble": ""}

    def take(number: int) -> None:
        recorder.take(FrameSet(f"{number:04d}", {"cam0": image, "cam1": image}, number * 10**8, number * 5.0))
        while recorder.state.waiting:
            time.sleep(0.001)

    number = 0
    while not recorder.trouble and number < 100:
        number += 1
        take(number)
    seen["trouble"], seen["paused_at"], written = recorder.trouble, number, recorder.state.written
    (folder / "other").unlink()
    while recorder.trouble and number < 10_000:
        number += 1
        take(number)
        time.sleep(0.02)
    seen["goes_on_at"] = number
    kept = recorder.keep("full")
    recorder.close()
    seen["counted"] = [recorder.state.written, recorder.state.dropped]
    capture = read_capture(kept or folder)
    seen["frames"] = [*map(int, capture.frames)]
    seen["expected"] = [*range(1, written + 1), number]
    files = [path for its in capture.files.values() for path in its.values()]
    seen["whole"] = len(files) == 2 * len(capture.frames) and all(
        np.array_equal(read_image(path), image) for path in files
    )
    seen["hidden"] = [p.name for p in (kept or folder).rglob(".*")]
    print(json.dumps(seen))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
