"""An opened camera through Aravis: applies settings to its features, receives images, sends triggers; its inspection.

An inspection tells a camera's size, pixel formats and triggers, and whether it accepts the settings.
"""

from __future__ import annotations

import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beltscape.core.errors import InputError
from beltscape.sources.genicam.aravis import glib_error_type, load_aravis, resolve_device
from beltscape.sources.genicam.settings import CamerasSettings

if TYPE_CHECKING:
    from gi.repository import GLib


PTP = ("PtpEnable", "GevIEEE1588")
"""Features that enable a shared clock: the standard's name (SFNC 2), older cameras' name."""


class Features:
    """One camera's features; a setting that the camera does not support is refused by name."""

    def __init__(self, lib: Any, name: str, camera: Any) -> None:
        """``lib``: the Aravis module; ``camera``: an opened camera of it."""
        self._lib = lib
        self._name = name
        self._camera = camera

    def require_feature(self, feature: str, setting: str) -> None:
        """Raise InputError unless the camera has the feature."""
        if not self._camera.is_feature_available(feature):
            raise InputError(f"{self._name}: the camera has no feature {feature}; correct {setting}")

    def apply(self, settings: CamerasSettings, size_px: tuple[int, int] | None) -> None:
        """Set all features of a camera that is not sending. Aravis's own errors pass through."""
        self._apply_pixel_format(settings, size_px)
        self._apply_exposure(settings.exposure_of(self._name), settings.gain_of(self._name))
        if settings.adaptive_exposure is not None:
            bounds = self._camera.get_exposure_time_bounds()
            self._require_within(
                "adaptive_exposure.shortest_us", settings.adaptive_exposure.shortest_us, bounds
            )
            self._require_within(
                "adaptive_exposure.longest_us", settings.adaptive_exposure.longest_us, bounds
            )
        self._apply_trigger(settings)
        if settings.clocks == "ptp":
            self._enable_shared_clock()
        if self._camera.is_gv_device():
            self._apply_network(settings)

    def _apply_pixel_format(self, settings: CamerasSettings, size_px: tuple[int, int] | None) -> None:
        wanted = settings.format_of(self._name)
        offered: list[str] = self._camera.dup_available_pixel_formats_as_strings() or []
        if wanted not in offered:
            raise InputError(
                f"{self._name}: the camera offers no {wanted}; it has {', '.join(sorted(offered))}"
            )
        self._camera.set_pixel_format_from_string(wanted)
        if size_px is None:
            return
        x, y = settings.offset_of(self._name)
        sensor = self._camera.get_sensor_size()
        if x + size_px[0] > sensor.width or y + size_px[1] > sensor.height:
            raise InputError(
                f"{self._name}: the rig's {size_px[0]}×{size_px[1]} px from {x}, {y} on do not fit on the sensor's "
                f"{sensor.width}×{sensor.height}; another camera, binning or offset_px?"
            )
        if (sensor.width, sensor.height) != size_px or self._camera.get_region()[2:] != size_px:
            self._camera.set_region(x, y, *size_px)

    def _apply_exposure(self, exposure_us: float | None, gain_db: float | None) -> None:
        off = self._lib.Auto.OFF
        if exposure_us is not None:
            self._require_control("exposure time", "exposure_us", self._camera.is_exposure_time_available())
            if self._camera.is_exposure_auto_available():
                self._camera.set_exposure_time_auto(off)
            self._require_within("exposure_us", exposure_us, self._camera.get_exposure_time_bounds())
            self._camera.set_exposure_time(exposure_us)
        if gain_db is not None:
            self._require_control("gain", "gain_db", self._camera.is_gain_available())
            if self._camera.is_gain_auto_available():
                self._camera.set_gain_auto(off)
            self._require_within("gain_db", gain_db, self._camera.get_gain_bounds())
            self._camera.set_gain(gain_db)

    def _require_control(self, what: str, setting: str, is_available: bool) -> None:
        if not is_available:
            raise InputError(f"{self._name}: the camera has no feature for its {what}; leave {setting} out")

    def read_back(self) -> AppliedSettings:
        """Return what the camera says of its exposure time and gain, which it may have rounded."""
        exposure = self._camera.get_exposure_time() if self._camera.is_exposure_time_available() else None
        gain = self._camera.get_gain() if self._camera.is_gain_available() else None
        return AppliedSettings(exposure, gain)

    def _require_within(self, setting: str, value: float, bounds: Any) -> None:
        low, high = bounds[0], bounds[1]
        if not low <= value <= high:
            raise InputError(f"{self._name}: {setting} {value:g} is outside the camera's {low:g} to {high:g}")

    def _apply_trigger(self, settings: CamerasSettings) -> None:
        self._camera.set_acquisition_mode(self._lib.AcquisitionMode.CONTINUOUS)
        if settings.trigger == "free":
            self._camera.clear_triggers()
            if self._camera.is_frame_rate_available():
                self._camera.set_frame_rate(settings.frames_per_s)
            return
        source = "Software" if settings.trigger == "software" else settings.trigger_line
        offered: list[str] = self._camera.dup_available_trigger_sources() or []
        if source not in offered:
            raise InputError(
                f"{self._name}: the camera has no trigger input {source}; there are {', '.join(sorted(offered))}"
            )
        self._camera.set_trigger(source)
        if settings.trigger == "line" and self._camera.is_feature_available("TriggerActivation"):
            self._camera.set_string("TriggerActivation", settings.trigger_activation)

    def _enable_shared_clock(self) -> None:
        for feature in PTP:
            if self._camera.is_feature_available(feature):
                self._camera.set_boolean(feature, True)
                return

    def _apply_network(self, settings: CamerasSettings) -> None:
        if settings.packet_size is None:
            self._camera.gv_auto_packet_size()
        else:
            self._camera.gv_set_packet_size(settings.packet_size)
        if settings.packet_delay_ns:
            self._camera.gv_set_packet_delay(settings.packet_delay_ns)


@dataclass(frozen=True, slots=True)
class AppliedSettings:
    """What a camera says of itself after its settings were set."""

    exposure_us: float | None = None
    gain_db: float | None = None
    """None: the camera has no such feature."""
    trouble: str = ""
    """The setting that it refuses, in one line; empty: it accepts all."""


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
        self.applied = features.read_back()
        """Exposure time and gain as the camera states them."""
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


@dataclass(frozen=True, slots=True)
class Inspection:
    """The abilities of a camera."""

    size_px: tuple[int, int]
    """Width and height of its sensor."""
    formats: tuple[str, ...]
    """Pixel formats it offers."""
    triggers: tuple[str, ...]
    """Trigger inputs of the camera."""
    trouble: str = ""
    """Why it could not be inspected; empty if it could."""


def inspect_camera(device: str) -> Inspection:
    """Open a camera by its id and read its abilities; if it cannot be opened, ``trouble`` has the reason."""
    lib = load_aravis()
    try:
        camera = lib.Camera.new(device)
        sensor = camera.get_sensor_size()
        return Inspection(
            (sensor.width, sensor.height),
            tuple(sorted(camera.dup_available_pixel_formats_as_strings() or [])),
            tuple(sorted(camera.dup_available_trigger_sources() or [])),
        )
    except glib_error_type() as error:
        return Inspection((0, 0), (), (), f"{error.message}; does another program have it open?")


def find_unreachable(settings: CamerasSettings) -> str:
    """Return which cameras cannot be opened with their settings now, and why; empty if all can."""
    troubles = {name: check_settings(name, settings).trouble for name in settings.devices}
    return "; ".join(f"{name}: {trouble}" for name, trouble in troubles.items() if trouble)


def check_settings(name: str, settings: CamerasSettings) -> AppliedSettings:
    """Open a camera with its settings; return the one that it refuses, and what it says of exposure time and gain."""
    try:
        device = Device(name, settings, None, has_encoder=False)
    except InputError as error:
        return AppliedSettings(trouble=str(error))
    device.close()
    return device.applied
