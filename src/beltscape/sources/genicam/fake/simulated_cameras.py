"""Several simulated cameras, each in a process that can be killed and started again."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType

from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.sources.genicam.fake.album import pixel_format, write_album

FIRST_ADDRESS = 11
"""127.0.0.11, 127.0.0.12, …"""


class SimulatedCameras:
    """Cameras that send given images cyclically, one for each instant.

    All send the image of the same number at one instant, also a camera that was restarted. The loopback interface
    needs their addresses (``network.add_addresses``).
    """

    def __init__(
        self,
        folder: Path,
        pictures: Mapping[str, Sequence[Image]],
        frames_per_s: float,
        counts: Sequence[int] | None = None,
        counts_per_round: int = 0,
        exposure_us: float | None = None,
    ) -> None:
        """``folder`` holds their files while they run; ``frames_per_s``: their triggers' exact rate.

        ``counts``: the belt's count at each image; ``counts_per_round`` is added with each cycle through the images.
        ``exposure_us`` is the exposure time of the images, which are scaled to the cameras'; None: they are not.
        """
        self.devices = {name: f"127.0.0.{FIRST_ADDRESS + i}" for i, name in enumerate(pictures)}
        """Camera → address, as in [cameras] devices."""
        self.sizes_px = {name: (images[0].shape[1], images[0].shape[0]) for name, images in pictures.items()}
        """Camera → width, height."""
        self.formats = {name: pixel_format(images[0]) for name, images in pictures.items()}
        """Camera → pixel format."""
        self._folder = folder
        self._running: dict[str, subprocess.Popen[bytes]] = {}
        folder.mkdir(parents=True, exist_ok=True)
        for name, images in pictures.items():
            write_album(folder / f"{name}.npy", images)
        count = len(next(iter(pictures.values())))
        parameters = {
            "period_s": 1 / frames_per_s,
            "counts": list(counts or [0] * count),
            "round": counts_per_round,
            "exposure_us": exposure_us,
        }
        (folder / "bench.json").write_text(json.dumps(parameters))

    def start(self, *names: str) -> None:
        """Start the named cameras, or all; they run when the call returns."""
        new: dict[str, subprocess.Popen[bytes]] = {}
        for name in names or self.devices:
            self.kill(name)
            command = [sys.executable, "-m", "beltscape.sources.genicam.fake", "one", str(self._folder), name]
            new[name] = subprocess.Popen(
                [*command, self.devices[name]], stdin=subprocess.PIPE, stdout=subprocess.PIPE
            )
        self._running.update(new)
        for name, process in new.items():
            if process.stdout is None or not process.stdout.readline():
                self.close()
                raise InputError(f"{self.devices[name]}: the simulated camera {name} did not start")

    def kill(self, name: str) -> None:
        """Kill a camera's process."""
        process = self._running.pop(name, None)
        if process is not None:
            process.kill()
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()

    def close(self) -> None:
        """Kill all."""
        for name in list(self._running):
            self.kill(name)

    def __enter__(self) -> SimulatedCameras:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
