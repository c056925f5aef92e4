"""Command ``python -m beltscape.sources.fake_genicam CAPTURE [--frames-per-s 10]``: simulate a capture's cameras."""

from __future__ import annotations

import argparse
import json
import signal
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

from beltscape.core.errors import BeltscapeError
from beltscape.core.frames import Image
from beltscape.sources.fake_genicam.camera import COUNTER, FakeCamera, InstantCounter, read_album
from beltscape.sources.fake_genicam.simulated_cameras import SimulatedCameras, add_addresses, read_pictures

_SKEW = 0.3
"""Allowed skew as a share of the time between frames; [cameras] takes less than `settings.WINDOW_SHARE` = 0.4."""
EXPOSURE_US = 1000.0
"""Exposure time at which the simulated cameras send the images of a capture as they are."""
STOP = (signal.SIGINT, signal.SIGTERM)


def main(words: Sequence[str]) -> int:
    """Run simulated cameras until interrupted; return the exit code, 2 on an error."""
    try:
        return (
            serve_camera(Path(words[1]), words[2], words[3]) if words[:1] == ["one"] else serve_capture(words)
        )
    except BeltscapeError as error:
        print(error, file=sys.stderr)
        return 2


def serve_capture(words: Sequence[str]) -> int:
    """Run all cameras of a capture, each in a process of its own."""
    parser = argparse.ArgumentParser(prog="python -m beltscape.sources.fake_genicam", description=__doc__)
    parser.add_argument("capture", type=Path, help="folder <capture>/<camera>/<frame>.png")
    parser.add_argument(
        "--frames-per-s", type=float, default=10.0, help="how fast they are triggered (default: 10)"
    )
    parser.add_argument("--mm-per-count", type=float, default=0.01, help="of the encoder (default: 0.01)")
    arguments = parser.parse_args(words)
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)  # sigwait below receives them
    pictures, counts, per_round = read_pictures(arguments.capture, arguments.mm_per_count)
    with tempfile.TemporaryDirectory() as folder:
        bench = SimulatedCameras(
            Path(folder), pictures, arguments.frames_per_s, counts, per_round, EXPOSURE_US
        )
        add_addresses(bench.devices.values())
        with bench:
            print(
                project_tables(bench, arguments.frames_per_s, arguments.mm_per_count if counts else None),
                flush=True,
            )
            signal.sigwait(STOP)
    return 0


def project_tables(bench: SimulatedCameras, frames_per_s: float, mm_per_count: float | None) -> str:
    """Return the tables of project.toml for these cameras.

    All clocks are this machine's, and its loopback interface has large packets. The cameras are processes that a
    busy machine delays, so the limits of skew, also the alarm's, are wider than for real cameras.
    """
    skew_ms = f"{_SKEW * 1e3 / frames_per_s:.4g}"
    lines = [
        "[cameras]",
        f"frames_per_s = {frames_per_s}",
        f'pixel_format = "{next(iter(bench.formats.values()))}"',
        f"exposure_us = {EXPOSURE_US:g}\nallowed_skew_ms = {skew_ms}",
        'clocks = "ptp"\npacket_size = 9000\n\n[cameras.devices]',
        *(f'{name} = "{address}"' for name, address in bench.devices.items()),
    ]
    if mm_per_count is not None:
        lines.append(f'\n[cameras.encoder]\nfeature = "{COUNTER}"\nmm_per_count = {mm_per_count}')
        lines.append('\n[encoder]\nkind = "camera"')
    lines.append(f"\n[alarms.camera_skew]\nskew_ms = {skew_ms}")
    return "\n".join(lines)


def serve_camera(folder: Path, name: str, address: str) -> int:
    """Run one camera in this process."""
    exposure_us = json.loads((folder / "bench.json").read_text())["exposure_us"]
    height, width = read_album(folder / f"{name}.npy").shape[1:3]
    camera = FakeCamera(address, name, _picture_function(folder, name), exposure_us, (width, height))
    print("listening", flush=True)
    sys.stdin.buffer.read()  # returns when the parent process ends, for whatever reason
    camera.close()
    return 0


def _picture_function(folder: Path, name: str) -> Callable[[int], tuple[Image, int]]:
    parameters = json.loads((folder / "bench.json").read_text())
    album, counts, per_round = read_album(folder / f"{name}.npy"), parameters["counts"], parameters["round"]
    instants = InstantCounter(folder / "instants", parameters["period_s"])

    def picture(camera_ns: int) -> tuple[Image, int]:
        rounds, index = divmod(instants.number_at(camera_ns), len(album))
        return album[index], counts[index] + rounds * per_round

    return picture


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
