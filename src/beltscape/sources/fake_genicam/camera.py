"""One simulated camera that sends given images.

Its images are in a memory-mapped file, which a new process opens at once; the processes of all cameras share the
counter of trigger instants.
"""

from __future__ import annotations

import ctypes
import fcntl
import mmap
import struct
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.core.errors import InputError
from beltscape.core.frames import Image
from beltscape.sources.genicam.aravis import load_aravis

COUNTER = "TestRegister"
"""The feature in which a simulated camera gives the belt's count: its spare register."""
COUNTER_ADDRESS = 0x1F0
"""Address of that register in Aravis' fake camera (arvfakecamera.h)."""
REGION_ADDRESSES = (0x100, 0x104)
"""Addresses of the width and the height of its images there."""
LIBRARY = "libaravis-0.8.so.0"

_Fill = ctypes.CFUNCTYPE(
    None, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_uint32, ctypes.c_uint32, ctypes.c_uint32
)


class FakeCamera:
    """A camera that answers on an address of this machine until ``close`` or the end of the process."""

    def __init__(
        self,
        address: str,
        serial: str,
        picture: Callable[[int], tuple[Image, int]],
        exposure_us: float | None = None,
        size_px: tuple[int, int] | None = None,
    ) -> None:
        """``picture``: camera time in ns → the image in its pixel format, and the belt's count.

        ``size_px``: width and height of what it reads from the start; a program may set another region.
        ``exposure_us`` is the exposure time of the images; they are brighter or darker at any other one. None: they
        are sent as they are.

        InputError if the address cannot be opened.
        """
        load_aravis()  # raises an error with the packages to install
        self._lib = _library()
        self._picture, self._exposure_us = picture, exposure_us
        self._fill = _Fill(
            self._fill_buffer
        )  # the reference keeps the callback alive while the library uses it
        self._camera = self._lib.arv_gv_fake_camera_new(address.encode(), serial.encode())
        if not self._lib.arv_gv_fake_camera_is_running(self._camera):
            raise InputError(
                f"{address}: no camera can listen there; give it to the loopback interface: "
                f"ip addr add {address}/8 dev lo label lo:{address.rpartition('.')[2]}"
            )
        self._inner = self._lib.arv_gv_fake_camera_get_fake_camera(self._camera)
        for register, length in zip(REGION_ADDRESSES, size_px or (), strict=False):
            self._lib.arv_fake_camera_write_register(self._inner, register, length)
        # PyGObject's binding of this one frees the callback at once
        self._lib.arv_fake_camera_set_fill_pattern(self._inner, self._fill, None)

    def _fill_buffer(self, buffer: int, _data: Any, exposure_us: int, _gain: int, _code: int) -> None:
        image, count = self._picture(self._lib.arv_buffer_get_timestamp(buffer))
        if self._exposure_us is not None and exposure_us != round(self._exposure_us):
            image = scale_exposure(image, exposure_us / self._exposure_us)
        self._lib.arv_fake_camera_write_register(self._inner, COUNTER_ADDRESS, count & 0xFFFFFFFF)
        room = self._lib.arv_fake_camera_get_payload(self._inner)  # the buffer itself says 0
        target = self._lib.arv_buffer_get_data(buffer, ctypes.byref(ctypes.c_size_t()))
        if image.nbytes == room:
            ctypes.memmove(target, np.ascontiguousarray(image).ctypes.data, room)
        else:
            ctypes.memset(target, 0, room)  # another size or format was set

    def close(self) -> None:
        """Stop listening."""
        self._lib.g_object_unref(self._camera)


def scale_exposure(image: Image, factor: float) -> Image:
    """Return an image as it would be with another exposure time; what saturates stays at the top of the range."""
    top = float(np.iinfo(image.dtype).max)
    return np.rint(image * np.float64(factor)).clip(0, top).astype(image.dtype)


def _library() -> Any:
    lib = ctypes.CDLL(LIBRARY)
    pointer, size = ctypes.c_void_p, ctypes.c_size_t
    for name, result, arguments in (
        ("arv_gv_fake_camera_new", pointer, [ctypes.c_char_p, ctypes.c_char_p]),
        ("arv_gv_fake_camera_is_running", ctypes.c_int, [pointer]),
        ("arv_gv_fake_camera_get_fake_camera", pointer, [pointer]),
        ("arv_fake_camera_set_fill_pattern", None, [pointer, _Fill, pointer]),
        ("arv_fake_camera_write_register", ctypes.c_int, [pointer, ctypes.c_uint32, ctypes.c_uint32]),
        ("arv_fake_camera_get_payload", size, [pointer]),
        ("arv_buffer_get_data", pointer, [pointer, ctypes.POINTER(size)]),
        ("arv_buffer_get_timestamp", ctypes.c_uint64, [pointer]),
        ("g_object_unref", None, [pointer]),
    ):
        function = getattr(lib, name)
        function.restype, function.argtypes = result, arguments
    return lib


def write_album(path: Path, images: Sequence[Image]) -> None:
    """Write images of one size and type."""
    first = images[0]
    album = np.lib.format.open_memmap(path, "w+", first.dtype, (len(images), *first.shape))
    for index, image in enumerate(images):
        if image.shape != first.shape or image.dtype != first.dtype:
            raise InputError(
                f"picture {index}: {image.shape} {image.dtype} among {first.shape} {first.dtype}"
            )
        album[index] = image
    album.flush()


def read_album(path: Path) -> Image:
    """Return the images (n, H, W) or (n, H, W, 3), read from the disk on access."""
    return np.load(path, mmap_mode="r")


def pixel_format(image: Image) -> str:
    """Return GenICam's name of the format that transmits an image unchanged."""
    if image.ndim == 3:
        return "RGB8"
    return "Mono8" if image.dtype == np.uint8 else "Mono16"


COUNTER_LAYOUT = struct.Struct("<qq")
"""Number of the newest instant, and its time on the cameras' common clock."""
FOLLOWING_GAIN = 0.1
"""Gain by which the instants follow the images: triggers come slightly early or late."""


class InstantCounter:
    """Counts instants in a shared file; they are one period apart, and an image belongs to the nearest one."""

    def __init__(self, path: Path, period_s: float) -> None:
        """Open the file ``path``, or create it."""
        self._file = path.open("r+b" if path.exists() else "w+b")
        if path.stat().st_size < COUNTER_LAYOUT.size:
            self._file.write(COUNTER_LAYOUT.pack(-1, 0))
            self._file.flush()
        self._memory = mmap.mmap(self._file.fileno(), COUNTER_LAYOUT.size)
        self._period_ns = round(period_s * 1e9)

    def number_at(self, camera_ns: int) -> int:
        """Return the number of the instant of an image at that time of the cameras' common clock, from 0."""
        fcntl.flock(self._file, fcntl.LOCK_EX)
        try:
            number, at_ns = COUNTER_LAYOUT.unpack(self._memory)
            if number < 0:
                number, at_ns = 0, camera_ns
            steps = round((camera_ns - at_ns) / self._period_ns)
            offset_ns = camera_ns - (at_ns + steps * self._period_ns)
            newest = max(0, steps)  # an image may belong to an earlier instant
            at_ns += newest * self._period_ns + round(FOLLOWING_GAIN * offset_ns)
            self._memory[:] = COUNTER_LAYOUT.pack(number + newest, at_ns)
            return max(0, number + steps)
        finally:
            fcntl.flock(self._file, fcntl.LOCK_UN)

    def close(self) -> None:
        """Close the file."""
        self._memory.close()
        self._file.close()
