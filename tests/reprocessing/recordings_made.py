"""Recordings without files, for the cut into pieces."""

from __future__ import annotations

from beltscape.reprocessing.recordings.recording import Place, RecordedFrame, Recording

STEP_MM = 50.0
FRAME_NS = 125_000_000


def make_recording(
    name: str, first: int, count: int, *, digest: str = "", has_encoder: bool = True, clock_ns: int = 0
) -> Recording:
    """Return a recording of the frames ``first`` … of one belt at a constant speed."""
    frames = tuple(
        RecordedFrame(
            f"{number:05d}",
            clock_ns + number * FRAME_NS,
            number * STEP_MM if has_encoder else None,
            {camera: f"{camera}/{number:05d}.png" for camera in ("cam0", "cam1")},
            {},
        )
        for number in range(first, first + count)
    )
    return Recording(name, Place(f"/data/{name}"), frames, 10**18 + first * FRAME_NS, digest or name)
