"""Settings of a plan; the defaults are the paper's rig (Table 1, section 3.1)."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import (
    BASELINE,
    BELT_SPEED,
    BELT_WIDTH,
    EXPOSURE,
    LOAD_HEIGHT,
    RIG_HEIGHT,
    TOP_WIDTH,
)

TABLE_1_ANGLE_DEG = 57.0
"""Horizontal angle of view that the paper states for its camera and lens."""

REFERENCE_PATCH_PX = 21
"""Edge of the patch for which the matching σ is given; the usual window of pairwise matching."""

Width = Annotated[float, BELT_WIDTH]
Height = Annotated[float, RIG_HEIGHT]
Baseline = Annotated[float, BASELINE]
LoadHeight = Annotated[float, LOAD_HEIGHT]
Exposure = Annotated[float, EXPOSURE]
Share = Annotated[float, Field(gt=0, le=1)]
"""A share, above 0."""
Side = Annotated[int, Field(ge=16, le=20_000)]
"""A side of an image, px; 20,000 is above any area sensor."""
Positive = Annotated[float, Field(gt=0, le=1e6, allow_inf_nan=False)]
"""A positive number; the limit only catches slips of the keyboard."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PlannedBelt(_Part):
    """The belt's cross-section and its load."""

    width_mm: Width = 800.0
    """Width of the belt, measured along its surface."""
    span_mm: Width = 780.0
    """w: horizontal distance between the vertices of the two side idlers."""
    flat_mm: Annotated[float, Field(ge=0, le=20_000)] = 300.0
    """Width of the level middle."""
    material_mm: tuple[Annotated[float, Field(ge=0, le=20_000)], LoadHeight] = (0.0, 150.0)
    """Lowest and highest surface to measure, above the level middle."""
    top_width_mm: Annotated[float, TOP_WIDTH] | None = None
    """Maximum width of the load at its top; None: the span, so that no load is missed."""
    speed_m_s: Annotated[float, BELT_SPEED] = 2.0
    """Speed of the belt."""
    lump_cover: Annotated[float, Field(ge=0, lt=1)] = 0.4
    """Share of the load's area covered by protruding lumps, which occlude the view of cameras."""

    @model_validator(mode="after")
    def _check_order(self) -> PlannedBelt:
        if self.span_mm > self.width_mm:
            raise ValueError(
                f"span_mm = {self.span_mm:g} is more than the belt's width_mm = {self.width_mm:g}"
            )
        if self.flat_mm >= self.span_mm:
            raise ValueError(f"flat_mm = {self.flat_mm:g} must be smaller than span_mm = {self.span_mm:g}")
        if self.material_mm[0] >= self.material_mm[1]:
            raise ValueError(f"material_mm = {list(self.material_mm)}: the first must be the smaller one")
        return self

    @property
    def trough_rad(self) -> float:
        """Return the slope of the wings, from width, span and level middle."""
        return float(np.arccos((self.span_mm - self.flat_mm) / (self.width_mm - self.flat_mm)))

    @property
    def edge_mm(self) -> float:
        """Return the height of the belt's edges (the idlers' vertices) above the level middle."""
        return (self.width_mm - self.flat_mm) / 2 * float(np.sin(self.trough_rad))

    @property
    def top_mm(self) -> float:
        """Return the highest surface."""
        return self.material_mm[1]

    @property
    def planes(self) -> tuple[tuple[float, float], ...]:
        """Return (height above the level middle, width to be seen there), mm: belt, edges, top of the load."""
        top = self.top_width_mm or self.span_mm
        return ((0.0, max(self.flat_mm, 10.0)), (self.edge_mm, self.span_mm), (self.top_mm, top))


class CameraSettings(_Part):
    """Camera and lens."""

    size_px: tuple[Side, Side] = (2448, 2048)
    """Width (across the belt) and height."""
    pitch_um: Annotated[float, Field(ge=0.5, le=50)] = 3.45
    """Distance of two pixels on the sensor."""
    focal_mm: Annotated[float, Field(ge=1, le=500)] = 8.0
    """Focal length of the lens."""
    f_number: Annotated[float, Field(ge=0.7, le=64)] = 2.8
    """Focal length over the diameter of the aperture."""
    angle_deg: Annotated[float, Field(gt=1, lt=170)] | None = None
    """α, the horizontal angle of view stated by the maker; None: from pixels and focal length."""
    max_fps: Positive = 79.1
    """Highest frame rate of the camera."""
    quantum_efficiency: Share = 0.62
    """Electrons per photon; of the most sensitive colour for a sensor with a colour mosaic."""
    read_noise_e: Annotated[float, Field(ge=0, le=1000)] = 2.5
    """Read noise, electrons, one standard deviation; the default is usual for pixels of 3.45 µm."""
    full_well_e: Positive = 10_500.0
    """Electrons at which a pixel saturates; the default is usual for pixels of 3.45 µm."""
    transmission: Share = 0.9
    """Transmission of the lens."""
    bytes_per_pixel: Annotated[float, Field(ge=1, le=8)] = 1.0
    """Bytes on the data link: 1 for 8 bits, 1.5 for 12 bits packed."""

    @property
    def focal_px(self) -> float:
        """Return the focal length in pixels."""
        return self.focal_mm * 1000 / self.pitch_um

    @property
    def lens_angle_rad(self) -> float:
        """Return the horizontal angle of view of a pinhole with this focal length."""
        return float(2 * np.arctan(self.size_px[0] / 2 / self.focal_px))

    @property
    def angle_rad(self) -> float:
        """Return α for Eq. 26: as stated, or Table 1's for Table 1's camera, or from the lens."""
        if self.angle_deg is not None:
            return float(np.deg2rad(self.angle_deg))
        table = CameraSettings.model_fields
        named = ("size_px", "pitch_um", "focal_mm")
        if all(getattr(self, key) == table[key].default for key in named):
            return float(np.deg2rad(TABLE_1_ANGLE_DEG))
        return self.lens_angle_rad


class RigSettings(_Part):
    """Constraints on the positions of the cameras."""

    auxiliaries: Annotated[int, Field(ge=1, le=8)] = 4
    """Number of auxiliary cameras."""
    first_deg: Annotated[float, Field(ge=-360, le=360)] = 0.0
    """Direction of the first auxiliary, from across the belt (+x) towards along it (+y)."""
    height_mm: Height | None = None
    """Height of the core camera above the level middle of the belt; None: recommended."""
    baseline_mm: Baseline | None = None
    """Distance from the core to each auxiliary; None: chosen."""
    max_height_mm: Height = 3000.0
    """Available height above the belt."""
    max_baseline_mm: Baseline | None = None
    """Available distance beside the core; None: half the span."""
    max_angle_deg: Annotated[float, Field(gt=1, le=80)] = 25.0
    """Angle between core and auxiliary, seen from the load; beyond it images of a patch differ too much."""
    margin_mm: Annotated[float, Field(ge=0, le=5000)] = 10.0
    """Margin to be seen beside the belt on either side."""
    min_seen: Share | None = None
    """Share of the area seen by the core that enough auxiliaries must see; None: 0.95, or 0.85 with one or two."""

    @property
    def required_views(self) -> int:
        """Return the number of auxiliaries that must see a point: two for redundancy, or one of one or two."""
        return 2 if self.auxiliaries > 2 else 1

    @property
    def required_share(self) -> float:
        """Return `min_seen`, or its default where it is None."""
        return self.min_seen or (0.95 if self.auxiliaries > 2 else 0.85)


class PrecisionSettings(_Part):
    """The precision of matching a patch."""

    matching_sigma_px: Annotated[float, Field(gt=0, le=10)] = 0.03
    """One standard deviation of a matched image coordinate in each camera, with the reference patch. 0.03 is
    cautious for multi-view matching of projected speckle, which reaches 0.01; pairwise matching reaches 0.1.
    """
    patch_px: Annotated[int, Field(ge=3, le=501)] = REFERENCE_PATCH_PX
    """Edge of the patch; σ is proportional to 1/edge, from the reference of 21 px."""
    calibration_sigma_mm: Annotated[float, Field(ge=0, le=1000)] = 0.0
    """σ of depth due to calibration, where it is known."""

    @property
    def sigma_px(self) -> float:
        """Return σ of a coordinate with this patch."""
        return self.matching_sigma_px * REFERENCE_PATCH_PX / self.patch_px


class LightSettings(_Part):
    """The projector, the ambient light and the exposure."""

    projector_lm: Annotated[float, Field(ge=0, le=1e7)] = 3000.0
    """Luminous flux of the projector, lumens; 0: no projector."""
    lit_area_mm: tuple[Width, Width] | None = None
    """Area of the projector's picture on the belt; None: the core camera's view of it."""
    ambient_lux: Annotated[float, Field(ge=0, le=2e5)] = 300.0
    """Illuminance by other light: 300 is a lit hall, 100,000 full sunlight."""
    reflectance: Share = 0.05
    """Reflectance of the darkest material; rubber and coal."""
    lumens_per_watt: Annotated[float, Field(gt=10, le=683)] = 300.0
    """Luminous efficacy of radiation; about 300 for white LEDs."""
    wavelength_nm: Annotated[float, Field(ge=300, le=1100)] = 560.0
    """Mean wavelength of the light; the limits are those of silicon."""
    exposure_us: Exposure | None = None
    """Exposure; None: the longest within `max_blur_px` of motion blur and the frame time."""
    max_blur_px: Annotated[float, Field(gt=0, le=100)] = 0.5
    """Tolerated travel of the belt during an exposure, px of the nearest material."""
    target_snr: Annotated[float, Field(gt=0, le=1000)] = 30.0
    """SNR of a lit dot on the darkest material."""


class PlanSettings(_Part):
    """All settings of a plan."""

    belt: PlannedBelt = PlannedBelt()
    camera: CameraSettings = CameraSettings()
    rig: RigSettings = RigSettings()
    precision: PrecisionSettings = PrecisionSettings()
    light: LightSettings = LightSettings()
    frames_per_point: Annotated[int, Field(ge=1, le=100)] = 3
    """Number of frames that show each piece of belt, for their fusion."""
