"""An opened camera through Aravis: applies settings, receives images, sends triggers."""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError
from beltscape.sources.genicam.access.aravis import glib_error_type, load_aravis, resolve_device
from beltscape.sources.genicam.access.features import Features
from beltscape.sources.genicam.settings import CamerasSettings

if TYPE_CHECKING:
    from gi.repository import GLib

EXTRA_BYTES = 4096
"""Space for chunks in a buffer beyond the payload that the camera states."""


@dataclass(frozen=True, slots=True)
class RawImage:
    """One image as received."""

    data: bytes
    code: int
    """Code of its pixel format."""
    size_px: tuple[int, int]
    """Width, height."""
    frame_id: int
    camera_ns: int
    arrival_ns: int
    """Host's monotonic clock at its first packet."""
    count: int | None
    """Count of the belt's encoder; None if this camera does not count it."""


class Device:
    """An opened camera; every call may block for seconds if the camera is gone, so each camera has its own thread."""

    def __init__(
        self, name: str, settings: CamerasSettings, size_px: tuple[int, int] | None, has_encoder: bool
    ) -> None:
        """Open the camera and start it; ``has_encoder``: it counts the belt's encoder.

        InputError if it does not answer, another program has opened it, or it refuses a setting.
        """
        self._lib = load_aravis()
        self._encoder = settings.encoder if has_encoder else None
        self._control = _Control()
        self._closed = False
        self._triggering = threading.Lock()
        self._arrival_clock = _ArrivalClock()
        self._parser: Any = None
        self._stream: Any = None
        self.broken = 0
        """Number of images with missing packets."""
        place = resolve_device(settings.devices[name])
        try:
            self._camera = self._lib.Camera.new(place)
        except glib_error_type() as error:
            raise _camera_error(name, settings, error) from error
        self._handler = self._camera.get_device().connect("control-lost", self._control.on_lost)
        with suppress(glib_error_type()):
            # a program that was killed leaves it sending: to that program's port, and with its settings locked
            self._camera.stop_acquisition()
        try:
            self._start(Features(self._lib, name, self._camera), settings, size_px)
        except glib_error_type() as error:
            self.close()
            raise _camera_error(name, settings, error) from error
        except InputError:
            self.close()
            raise

    def _start(self, features: Features, settings: CamerasSettings, size_px: tuple[int, int] | None) -> None:
        features.apply(settings, size_px)
        self._parser = self._create_chunk_parser(features)
        self._stream = self._create_stream(settings)
        self._camera.start_acquisition()

    def _create_chunk_parser(self, features: Features) -> Any:
        if self._encoder is None:
            return None
        if self._encoder.feature is not None:
            features.require_feature(self._encoder.feature, "encoder.feature")
            return None
        self._camera.set_chunks(self._encoder.chunk)
        return self._camera.create_chunk_parser()

    def _create_stream(self, settings: CamerasSettings) -> Any:
        stream = self._camera.create_stream(None, None)
        if settings.socket_buffer_bytes is not None and self._camera.is_gv_device():
            stream.set_property("socket-buffer", self._lib.GvStreamSocketBuffer.FIXED)
            stream.set_property("socket-buffer-size", settings.socket_buffer_bytes)
        payload = self._camera.get_payload() + EXTRA_BYTES
        for _ in range(settings.buffers):
            stream.push_buffer(self._lib.Buffer.new_allocate(payload))
        return stream

    @property
    def is_lost(self) -> bool:
        """Return whether the camera has stopped answering for some seconds."""
        return self._control.is_lost

    def receive(self, seconds: float) -> RawImage | None:
        """Return the next complete image; None if none arrives in time."""
        buffer = self._stream.timeout_pop_buffer(int(seconds * 1e6))
        if buffer is None:
            return None
        try:
            if buffer.get_status() != self._lib.BufferStatus.SUCCESS:
                self.broken += 1
                return None
            return self._raw(buffer)
        finally:
            self._stream.push_buffer(buffer)

    def _raw(self, buffer: Any) -> RawImage:
        arrival_ns = self._arrival_clock.monotonic_ns(buffer.get_system_timestamp())
        return RawImage(
            buffer.get_image_data(),
            buffer.get_image_pixel_format() & 0xFFFFFFFF,
            (buffer.get_image_width(), buffer.get_image_height()),
            buffer.get_frame_id(),
            buffer.get_timestamp(),
            arrival_ns,
            self._count(buffer),
        )

    def _count(self, buffer: Any) -> int | None:
        if self._encoder is None:
            return None
        try:
            if self._parser is not None:
                return self._parser.get_integer_value(buffer, f"Chunk{self._encoder.chunk}")
            return self._camera.get_integer(self._encoder.feature)
        except glib_error_type():
            return None

    def trigger(self) -> bool:
        """Trigger an image; return False if the camera does not answer, which blocks for seconds."""
        with self._triggering:
            if self._closed:
                return False
            try:
                self._camera.software_trigger()
            except glib_error_type():
                return False
        return True

    def set_exposure(self, exposure_us: float) -> bool:
        """Set the exposure time of the images from the next trigger on; return whether the camera answered."""
        with self._triggering:
            if self._closed:
                return False
            try:
                self._camera.set_exposure_time(exposure_us)
            except glib_error_type():
                return False
        return True

    def close(self) -> None:
        """Release the camera; blocks for seconds if it does not answer."""
        with self._triggering:  # a trigger call under way holds the camera
            self._closed = True
        device = self._camera.get_device()
        device.disconnect(self._handler)
        if self._stream is not None and not self._control.is_lost:
            with suppress(glib_error_type()):
                self._camera.stop_acquisition()
        # Aravis releases a camera with the last reference to it
        del device, self._parser, self._stream, self._camera


class _Control:
    """Receiver of the signal that the camera is lost; a separate object avoids a reference cycle with the camera."""

    def __init__(self) -> None:
        self.is_lost = False

    def on_lost(self, _device: Any) -> None:
        self.is_lost = True


def _camera_error(name: str, settings: CamerasSettings, error: GLib.Error) -> InputError:
    return InputError(f"{name} ({settings.devices[name]}): {error.message}")


class _ArrivalClock:
    """Converts arrivals from the system clock, which Aravis uses and which may be set, to the monotonic clock."""

    def __init__(self) -> None:
        self._offset_ns = time.time_ns() - time.monotonic_ns()

    def monotonic_ns(self, system_ns: int) -> int:
        """Return the monotonic time of an arrival, or now if the system clock was set since the last one."""
        now_ns = time.monotonic_ns()
        offset_ns = time.time_ns() - now_ns
        was_set = abs(offset_ns - self._offset_ns) > 1_000_000
        self._offset_ns = offset_ns
        return now_ns if was_set else min(system_ns - offset_ns, now_ns)
