"""Applying the settings to a camera's GenICam features."""

from __future__ import annotations

from typing import Any

from beltscape.core.errors import InputError
from beltscape.sources.genicam.settings import CamerasSettings

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
            if self._camera.is_exposure_auto_available():
                self._camera.set_exposure_time_auto(off)
            self._require_within("exposure_us", exposure_us, self._camera.get_exposure_time_bounds())
            self._camera.set_exposure_time(exposure_us)
        if gain_db is not None:
            if self._camera.is_gain_auto_available():
                self._camera.set_gain_auto(off)
            self._require_within("gain_db", gain_db, self._camera.get_gain_bounds())
            self._camera.set_gain(gain_db)

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
