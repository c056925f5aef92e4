"""Faults of the belt: risen, tilted, running off; material stuck to it, a splice, a torn edge, objects over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults.base import Degrees, Fault, GrowingFault, Millimetres, Seed, Share
from beltscape.simulate.shapes import make_box
from beltscape.simulate.solids.belt import BeltSettings, EdgeNotches
from beltscape.simulate.solids.fines import HeightField, ReflectanceModel, make_fines_mesh, make_fines_solid
from beltscape.simulate.world import Label, Solid

Edge = Annotated[float, Field(gt=0, le=5000)]
_CELL_MM = 4.0
"""Spacing of the height field of what sticks to the belt."""
_RAGGED_MM = 15.0
"""Spacing of the points of a torn edge's outline."""
_BELOW_MM = 2.0
"""Depth below the belt at which the field runs where nothing sticks."""


class MovedBelt(GrowingFault):
    """The belt with its load has risen, sunk or tilted under the rig: idlers changed, belt worn, rig moved."""

    rise_mm: Millimetres = 0.0
    """Upwards; negative: worn or sunk."""
    roll_deg: Degrees = 0.0
    """Rotation about the axis along the belt."""
    pitch_deg: Degrees = 0.0
    """Rotation about the axis across it."""

    def pose_at(self, frame: float) -> Pose:
        """Return the displacement of everything on the belt, in the world."""
        extent = self.extent_at(frame)
        rotation = extent * np.deg2rad((self.pitch_deg, self.roll_deg, 0.0))
        return Pose.of(rotation, (0.0, 0.0, extent * self.rise_mm))


class RunningOff(GrowingFault):
    """The belt runs to one side on its idlers."""

    misaligned_mm: Millimetres
    """Final misalignment to +x, in addition to the belt's own."""

    def apply(self, belt: BeltSettings, frame: float = 0) -> BeltSettings:
        """Return the belt's settings in a frame."""
        offset = self.extent_at(frame) * self.misaligned_mm
        return belt.model_copy(update={"misaligned_mm": belt.misaligned_mm + offset})


class CarryBack(GrowingFault):
    """Material stuck to the belt in patches, which comes round with it and is not transported."""

    thickness_mm: Annotated[float, Field(gt=0, le=200)] = 3.0
    coverage: Share = 0.5
    """Share of the belt that it covers."""
    seed: Seed = 1

    def make_solid(self, belt: BeltSettings, frame: float = 0) -> Solid | None:
        """Return the patches over the whole modelled belt as they are in a frame; None while there are none."""
        from scipy.ndimage import gaussian_filter

        thickness = self.thickness_mm * self.extent_at(frame)
        if thickness == 0 or self.coverage == 0:
            return None
        rng = np.random.default_rng(self.seed)
        x, y, ground = _make_grid(belt)
        field = gaussian_filter(rng.normal(size=ground.shape), 30.0 / _CELL_MM)
        level = np.quantile(field, 1 - self.coverage) if self.coverage < 1 else float(field.min()) - 1.0
        height = np.where(field > level, ground + thickness, ground - _BELOW_MM)
        mesh = make_fines_mesh(HeightField(x, y, height), belt)
        return replace(make_fines_solid(mesh, ReflectanceModel(0.09, 0.3, 0.0), rng), name="carry_back")


class Splice(GrowingFault):
    """A splice: a step across the whole belt that passes with it, once in every round of the modelled belt."""

    height_mm: Annotated[float, Field(gt=0, le=50)] = 3.0
    length_mm: Annotated[float, Field(gt=0, le=5000)] = 250.0
    bias_deg: Annotated[float, Field(ge=-60, le=60)] = 20.0
    """Angle of the splice to the line across the belt."""

    def make_solid(self, belt: BeltSettings, frame: float = 0) -> Solid | None:
        """Return the splice at the middle of the modelled belt; None before the fault."""
        height_mm = self.height_mm * self.extent_at(frame)
        if height_mm == 0:
            return None
        x, y, ground = _make_grid(belt)
        along = y[:, None] - np.tan(np.deg2rad(self.bias_deg)) * x
        height = np.where(np.abs(along) <= self.length_mm / 2, ground + height_mm, ground - _BELOW_MM)
        mesh = make_fines_mesh(HeightField(x, y, height), belt)
        grey = (belt.reflectance, belt.reflectance, belt.reflectance)
        return Solid("splice", Label.BELT, mesh.vertices_mm, mesh.faces, grey)


class TornEdge(GrowingFault):
    """A notch torn out of an edge, which passes with the belt, once in every round of the modelled belt."""

    side: Literal["left", "right"] = "right"
    """Of the direction of travel +y."""
    depth_mm: Annotated[float, Field(gt=0, le=500)] = 50.0
    """Greatest width that is missing, along the belt's surface."""
    length_mm: Annotated[float, Field(gt=0, le=5000)] = 300.0
    seed: Seed = 1
    """Of the ragged outline."""

    def missing_at(self, along_mm: NDArray[np.float64], frame: float = 0) -> NDArray[np.float64]:
        """Return the width (N,) that is missing at distances (N,) from the middle of the notch, as in the mesh."""
        knots, depth = self._outline_mm
        return self.extent_at(frame) * np.interp(along_mm, knots, depth, left=0.0, right=0.0)

    def make_notches(self, belt: BeltSettings, travel_mm: float, frame: float = 0) -> EdgeNotches:
        """Return the notch, and its copy a round before, after the belt has carried it by ``travel_mm``."""
        middles = travel_mm % belt.length_mm - np.array([belt.length_mm, 0.0])
        along = np.unique(np.concatenate([middle + self._outline_mm[0] for middle in middles]))
        missing = sum((self.missing_at(along - middle, frame) for middle in middles), np.zeros(len(along)))
        none = np.zeros(len(along))
        return EdgeNotches(along, *((missing, none) if self.side == "left" else (none, missing)))

    @property
    def _outline_mm(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the knots (N,) along the belt from the notch's middle, and the width (N,) that is missing there."""
        count = 2 * int(np.ceil(self.length_mm / _RAGGED_MM / 2)) + 1
        knots = np.linspace(-self.length_mm / 2, self.length_mm / 2, count)
        ragged = np.random.default_rng(self.seed).uniform(0.6, 1.0, count)
        depth = np.cos(np.pi * knots / self.length_mm) ** 0.5 * ragged
        depth[[0, -1]] = 0.0
        return knots, self.depth_mm * depth / depth.max()


class ForeignObject(Fault):
    """A box over the belt that does not travel with it: a jammed lump, a plate, an arm, a chain, a cable."""

    size_mm: tuple[Edge, Edge, Edge] = (90.0, 320.0, 6.0)
    """Across the belt, along it, and upwards."""
    above_mm: Annotated[float, Field(ge=0, le=2000)] = 160.0
    """Height of its lower side over the middle of the belt."""
    place_mm: tuple[Millimetres, Millimetres] = (0.0, 0.0)
    """Its middle, across the belt and along it."""
    sway_mm: tuple[Millimetres, Millimetres] = (0.0, 0.0)
    """By how much it swings to both sides of its middle, across and along."""
    period: Annotated[int, Field(ge=1, le=100_000)] = 10
    """Number of frames of a swing to and fro."""
    last: Annotated[int, Field(ge=0, le=100_000)] | None = None
    """The last frame with the object; None: it remains."""
    reflectance: Share = 0.4

    def is_active(self, frame: float) -> bool:
        """Return whether the object is there in a frame."""
        return frame >= self.first and (self.last is None or frame <= self.last)

    def make_solid(self, frame: float = 0) -> Solid | None:
        """Return the object as it is in a frame; None while it is not there."""
        if not self.is_active(frame):
            return None
        phase = np.sin(2 * np.pi * (frame - self.first) / self.period)
        x, y = (middle + sway * phase for middle, sway in zip(self.place_mm, self.sway_mm, strict=True))
        mesh = make_box(self.size_mm).transform(Pose(np.eye(3), np.array([x, y, self.above_mm])))
        grey = (self.reflectance, self.reflectance, self.reflectance)
        return Solid("foreign_object", Label.NOTHING, mesh.vertices_mm, mesh.faces, grey)


def join_notches(notches: Sequence[EdgeNotches]) -> EdgeNotches:
    """Return several notches as one; where they overlap the deeper one counts."""
    along = np.unique(np.concatenate([each.along_mm for each in notches]))
    left, right = np.zeros(len(along)), np.zeros(len(along))
    for each in notches:
        left = np.maximum(left, np.interp(along, each.along_mm, each.left_mm, left=0.0, right=0.0))
        right = np.maximum(right, np.interp(along, each.along_mm, each.right_mm, left=0.0, right=0.0))
    return EdgeNotches(along, left, right)


def move_solids(solids: tuple[Solid, ...], pose: Pose) -> tuple[Solid, ...]:
    """Return the solids after a displacement in the world; the floor remains."""
    return tuple(
        solid if solid.label == Label.FLOOR else replace(solid, vertices_mm=pose.apply(solid.vertices_mm))
        for solid in solids
    )


def _make_grid(belt: BeltSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return x (Nx,), y (Ny,) over the whole belt and the height (Ny, Nx) of its upper side, mm."""
    left, right = belt.half_width_mm
    inset = 1.0  # the last nodes lie within the belt
    x = np.linspace(inset - left, right - inset, int((left + right) / _CELL_MM) + 1)
    half = belt.length_mm / 2
    y = np.linspace(-half, half, int(belt.length_mm / _CELL_MM) + 1)
    return x, y, belt.height_at(x, y[:, None])
