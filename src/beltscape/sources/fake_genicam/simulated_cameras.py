"""Several simulated cameras, each in a process that can be killed and started again.

Their images and the belt's counts are those of a capture; their addresses are on the loopback interface, best in a
network namespace of its own.
"""

from __future__ import annotations

import ctypes
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Generator, Iterable, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from types import TracebackType

from beltscape.core.errors import InputError, OutputError
from beltscape.core.frames import Image
from beltscape.files.capture import read_capture
from beltscape.files.encoder_csv import read_encoder
from beltscape.files.images import is_grey_throughout, read_image
from beltscape.sources.fake_genicam.camera import pixel_format, write_album

FIRST_ADDRESS = 11
"""127.0.0.11, 127.0.0.12, …"""


class SimulatedCameras:
    """Cameras that send given images cyclically, one for each instant.

    All send the image of the same number at one instant, also a camera that was restarted. The loopback interface
    needs their addresses (`add_addresses`).
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
            command = [sys.executable, "-m", "beltscape.sources.fake_genicam", "one", str(self._folder), name]
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


def read_pictures(folder: Path, mm_per_count: float) -> tuple[dict[str, list[Image]], list[int], int]:
    """Return each camera's images of the common frames, the belt's counts at them, and the counts of one cycle.

    The counts are empty without an encoder.csv. InputError if no frame has images of all cameras.
    """
    capture = read_capture(folder)
    frames = [f for f in capture.frames if all(f in files for files in capture.files.values())]
    if not frames:
        raise InputError(f"{folder}: no frame that all cameras have")
    pictures = {name: _read_uniform([files[f] for f in frames]) for name, files in capture.files.items()}
    counts = _read_counts(folder / "encoder.csv", frames, mm_per_count)
    if len(counts) < 2:
        return pictures, [], 0
    # from the last image to the first one the belt travels as far as between two others on average
    return pictures, counts, counts[-1] - counts[0] + round((counts[-1] - counts[0]) / (len(counts) - 1))


def _read_uniform(files: list[Path]) -> list[Image]:
    """Read a camera's images, which must have one size and pixel format; all become grey if one of them is.

    Raises
    ------
    InputError
        When one differs from the first; the error names the file.
    """
    images = [read_image(path) for path in files]
    if any(image.ndim == 2 for image in images):
        images = [
            image[..., 0].copy() if image.ndim == 3 and is_grey_throughout(image) else image
            for image in images
        ]
    first = images[0]
    for path, image in zip(files, images, strict=True):
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                f"{path}: {_describe_format(image)}, but {files[0]} is {_describe_format(first)}; "
                "a camera sends images of one form"
            )
    return images


def _describe_format(image: Image) -> str:
    colour = "grey" if image.ndim == 2 else "RGB"
    return f"{image.shape[1]}×{image.shape[0]} px {colour} {8 * image.itemsize} bit"


def _read_counts(path: Path, frames: list[str], mm_per_count: float) -> list[int]:
    if not path.is_file():
        return []
    position = {reading.frame: reading.belt_position_mm for reading in read_encoder(path)}
    missing = [f for f in frames if f not in position]
    if missing:
        raise InputError(f"{path}: no row for frame {missing[0]}")
    return [round(position[f] / mm_per_count) for f in frames]


CLONE_NEWNET = 0x40000000
"""Flag of unshare(2): a network namespace of its own (linux/sched.h)."""


def add_addresses(addresses: Iterable[str]) -> None:
    """Add addresses to the loopback interface, unless it has them; OutputError if the rights are missing."""
    _run_ip("link", "set", "lo", "up")
    present = subprocess.run(
        ["ip", "-o", "addr", "show", "dev", "lo"], capture_output=True, text=True, check=False
    )
    for address in addresses:
        if f"{address}/8" not in present.stdout:
            # a label of its own: Aravis identifies interfaces by their names
            _run_ip("addr", "add", f"{address}/8", "dev", "lo", "label", f"lo:{address.rpartition('.')[2]}")


def _run_ip(*arguments: str) -> None:
    if shutil.which("ip") is None:
        raise OutputError("simulated cameras: the program ip is missing; install Debian's iproute2")
    done = subprocess.run(["ip", *arguments], capture_output=True, text=True, check=False)
    if done.returncode:
        raise OutputError(f"ip {' '.join(arguments)}: {done.stderr.strip()}; it needs the rights of root")


@contextmanager
def own_network(addresses: Iterable[str]) -> Generator[None]:
    """Give this thread, the threads it starts and their programs a network of their own with ``addresses``.

    OutputError if the rights are missing.
    """
    libc = ctypes.CDLL(None, use_errno=True)
    here = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    try:
        if libc.unshare(CLONE_NEWNET):
            raise OutputError(
                f"no network of its own ({os.strerror(ctypes.get_errno())}); it needs the rights of root"
            )
        try:
            add_addresses(addresses)
            yield
        finally:
            libc.setns(here, CLONE_NEWNET)
    finally:
        os.close(here)
