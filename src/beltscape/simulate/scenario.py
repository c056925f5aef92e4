"""A scenario: the description of a simulated scene in its TOML file; the defaults are the paper's laboratory."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.geometry.lens import MODELS
from beltscape.core.quantities import BASELINE, BELT_WIDTH, DISTANCE, FRAME_RATE, RIG_HEIGHT
from beltscape.simulate.faults.settings import Faults
from beltscape.simulate.rendering.optics import Optics
from beltscape.simulate.rendering.render import RenderSettings
from beltscape.simulate.rendering.sensor import Sensor
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.heap import HeapSettings
from beltscape.simulate.time_of_flight_signal import TofSettings

Place = Annotated[float, Field(ge=-1e5, le=1e5, allow_inf_nan=False)]
Angle = Annotated[float, Field(ge=-360, le=360)]
Seed = Annotated[int, Field(ge=0, lt=2**63)]

KINDS = {
    "calibration": "a board, held into the cameras' view in many poses",
    "module": "the calibration module on the belt",
    "belt_empty": "the empty belt",
    "belt_loaded": "a heap of rocks on the belt",
    "belt_moving": "the heap passing by, with encoder.csv",
}
"""Description of each kind of scene."""


class _Part(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class RigSpec(_Part):
    """The cameras: those of the paper (Table 1), the core above the belt and the others around it, or a given rig."""

    seed: Seed = 1
    """Seed of the deviations of lenses and mounting: another seed gives another plant."""
    file: Path | None = None
    """rig.json of the true rig, planned or calibrated; None: built from the other keys."""
    height_mm: Annotated[float, RIG_HEIGHT] = 744.0
    """Height of the core above the belt's level middle."""
    auxiliaries: Annotated[int, Field(ge=1, le=16)] = 4
    baseline_mm: Annotated[float, BASELINE] = 300.0
    """Horizontal distance from the core to each auxiliary."""
    baselines_mm: tuple[Annotated[float, BASELINE], ...] = ()
    """The distance of each auxiliary by itself, such as 260 beside and 200 ahead; empty: ``baseline_mm`` for all."""
    first_deg: Angle = 0.0
    """Direction of the first auxiliary, from across the belt towards along it."""
    around_deg: Annotated[float, Field(gt=0, le=360)] = 360.0
    """Angle around the core in which the auxiliaries stand evenly: 360 all around; two in 180 form an L."""
    yaw_deg: Angle = 0.0
    """Angle by which the whole rig is turned about the vertical against the belt, from across it towards along it."""
    tilt_deg: Annotated[float, Field(ge=-45, le=45)] = 0.0
    """Angle by which the core looks forward from the vertical, along the rig's own y."""
    aim_mm: Place = 60.0
    """Height above the belt of the point at which all cameras are aimed."""
    size_px: tuple[Annotated[int, Field(ge=64, le=20_000)], Annotated[int, Field(ge=64, le=20_000)]] = (
        2448,
        2048,
    )
    pitch_um: Annotated[float, Field(ge=0.5, le=50)] = 3.45
    focal_mm: Annotated[float, Field(ge=1, le=500)] = 8.0
    scale: Annotated[float, Field(gt=0.02, le=1)] | None = None
    """Scale of the images to the sensor: 0.5 averages 2 × 2 pixels. None: 0.5, or 1 for a rig from a file."""
    model: Literal["brown", "rational", "thin_prism", "tilted", "fisheye"] = "brown"
    """Lens model of the cameras."""
    distortion: tuple[Place, ...] = (-0.08, 0.1, 0.0, 0.0, 0.0)
    """Coefficients of the lens model on average: of ``brown`` k1, k2, p1, p2, k3."""
    scatter: Annotated[float, Field(ge=0, le=10)] = 1.0
    """Factor on the deviations of lenses and mounting. 0: nominal; 1: standard deviations of 0.4 % of the focal
    length, 1 % of the width for the principal point, 5 mm and 0.7° of mounting.
    """

    @model_validator(mode="after")
    def _check_lens(self) -> RigSpec:
        names = MODELS[self.model].coefficients
        if len(self.distortion) != len(names):
            raise ValueError(
                f"distortion has {len(self.distortion)} numbers: model {self.model} takes {len(names)}, "
                f"{', '.join(names)}"
            )
        return self

    @model_validator(mode="after")
    def _check_baselines(self) -> RigSpec:
        if len(self.baselines_mm) not in (0, self.auxiliaries):
            raise ValueError(
                f"baselines_mm has {len(self.baselines_mm)} numbers: give one for each of the {self.auxiliaries} "
                "auxiliaries, or none"
            )
        return self

    @model_validator(mode="after")
    def _check_aim(self) -> RigSpec:
        if self.aim_mm >= self.height_mm:
            raise ValueError(f"aim_mm = {self.aim_mm:g}: must be below height_mm = {self.height_mm:g}")
        return self

    @property
    def image_scale(self) -> float:
        """Return `scale`, or its default where it is None."""
        return self.scale or (0.5 if self.file is None else 1.0)


class ProjectorSpec(_Part):
    """The projector beside the core."""

    position_mm: tuple[Place, Place, Place] = (50.0, -50.0, 757.0)
    """In the world: x across, y along, z above the belt's level middle."""
    covers_mm: Annotated[float, BELT_WIDTH] = 960.0
    """Width of its picture on the level middle; the projector is aimed at the origin."""
    size_px: tuple[Annotated[int, Field(ge=64, le=8192)], Annotated[int, Field(ge=64, le=8192)]] = (
        1920,
        1200,
    )
    pattern: Path | Literal["paper", "fine", "dense", "cells", "stripes", "noise"] = "paper"
    """A preset of ``target pattern``, or the path of a pattern.json, or another pattern of grains: square ``cells``,
    each lit or dark; ``stripes`` of random widths along the rows of cells; blue ``noise`` without a grid."""
    cell_px: Annotated[float, Field(ge=1, le=100)] = 3.0
    """Size of the grains of ``cells``, ``stripes`` and ``noise``, in the projector's pixels."""
    seed: Seed = 1
    """Seed of a pattern that is drawn."""
    power: Annotated[float, Field(ge=0, le=1e4)] = 10.0
    """Irradiance of a white pixel on a surface facing it at 1000 mm, in units of the ambient light."""
    blur_px: Annotated[float, Field(ge=0, le=20)] = 0.7
    """Blur of its lens, in the projector's pixels."""
    gamma: Annotated[float, Field(ge=1, le=4)] = 2.2
    """Light is the pixel value of the pattern to this power."""

    @model_validator(mode="after")
    def _check_position(self) -> ProjectorSpec:
        if self.position_mm[2] <= 0:
            raise ValueError(f"position_mm = {list(self.position_mm)}: z must be over the belt, above 0")
        return self


class ModuleSpec(_Part):
    """The position of the module."""

    file: Path | None = None
    """module.toml; None: the paper's module."""
    x_mm: Place = 0.0
    y_mm: Place = 0.0
    turn_deg: Angle = 8.0
    reflectance: Annotated[float, Field(gt=0, le=1)] = 0.55


class BoardSpec(_Part):
    """The board and its poses, one for each frame."""

    file: Path | None = None
    """board.toml; None: ChArUco 11 × 8, squares of 34 mm."""
    depth_mm: tuple[Annotated[float, DISTANCE], Annotated[float, DISTANCE]] = (560.0, 760.0)
    """Range of the depth of its centre in the core camera."""
    tilt_deg: Annotated[float, Field(ge=0, le=75)] = 32.0
    """Maximum tilt."""
    reach: Annotated[float, Field(ge=0, le=1)] = 0.5
    """Maximum displacement of its centre towards the edges of the core's view, as a share."""
    faces_core: bool = False
    """Whether it lies on the lens's true rays, at ``depth_mm`` from the core along them and turned towards it: for
    wide lenses, whose edges a board that is only shifted sideways does not reach."""


class MotionSpec(_Part):
    """The motion of the belt; used by belt_moving."""

    speed_mm_s: Annotated[float, Field(ge=-1e5, le=1e5)] = 1000.0
    """Towards +y; a negative speed is towards −y."""
    frames_per_s: Annotated[float, FRAME_RATE] = 5.0
    exposure_us: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Exposure time that blurs the moving load; 0: none, as with a flash."""
    start_mm: Place | None = None
    """Position of the heap's centre in the first frame; None: the heap is about to enter the view."""
    gap_mm: Annotated[float, Field(ge=0, le=1e5)] = 0.0
    """Empty belt before the heap comes again, beyond the length of its fines; rocks lie up to 120 mm beyond them."""
    encoder_scale: Annotated[float, Field(gt=0, le=10)] = 1.0
    """The encoder's travel over the belt's travel."""


class TofSpec(_Part):
    """A time-of-flight camera vertically above the belt."""

    height_mm: Annotated[float, RIG_HEIGHT] = 744.0
    camera: TofSettings = TofSettings()


class Scenario(_Part):
    """A scene."""

    kind: Literal["calibration", "module", "belt_empty", "belt_loaded", "belt_moving"]
    seed: Seed = 1
    """Seed of what differs from capture to capture: noise, heap, poses of the board; not of the plant."""
    frames: Annotated[int, Field(ge=1, le=100_000)] | None = None
    """None: 24 for a calibration, until the heap has passed for a moving belt, else 1."""
    speckle: bool = True
    """Whether the projector is on; it is always off in a calibration."""
    colour: bool | None = None
    """Whether images are RGB; None: where the projector is on."""
    auto_exposure: bool = True
    """Whether the exposure makes the core's first image as bright as possible; else ``sensor`` sets it."""
    gain_spread: Annotated[float, Field(ge=0, lt=1)] = 0.05
    """Maximum relative deviation of brightness from camera to camera."""
    ambient: Annotated[float, Field(ge=0, le=1e4)] = 1.0
    rig: RigSpec = RigSpec()
    optics: Optics = Optics()
    sensor: Sensor = Sensor()
    projector: ProjectorSpec = ProjectorSpec()
    belt: BeltSettings = BeltSettings()
    heap: HeapSettings = HeapSettings()
    module: ModuleSpec = ModuleSpec()
    board: BoardSpec = BoardSpec()
    motion: MotionSpec = MotionSpec()
    tof: TofSpec | None = None
    faults: Faults = Faults()
    render: RenderSettings = RenderSettings()

    @model_validator(mode="after")
    def _check_order(self) -> Scenario:
        if self.board.depth_mm[0] >= self.board.depth_mm[1]:
            raise ValueError(
                f"board.depth_mm = {list(self.board.depth_mm)}: the first must be the smaller one"
            )
        return self

    @model_validator(mode="after")
    def _check_torn_edges(self) -> Scenario:
        wing = self.belt.straight_wing_mm
        for torn in self.faults.torn_edge:
            if torn.depth_mm >= wing:
                raise ValueError(
                    f"faults.torn_edge.depth_mm = {torn.depth_mm:g}: must be less than the {wing:.0f} mm of the "
                    "belt's wing beyond its fold"
                )
            if torn.length_mm >= self.belt.length_mm:
                raise ValueError(
                    f"faults.torn_edge.length_mm = {torn.length_mm:g}: must be less than "
                    f"belt.length_mm = {self.belt.length_mm:g}"
                )
        return self

    @property
    def is_lit(self) -> bool:
        """Return whether the projector's pattern is on the scene."""
        return self.speckle and self.kind != "calibration" and not self.faults.dead_projector
