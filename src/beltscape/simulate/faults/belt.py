"""Faults of the belt: risen, tilted, running off, with material stuck to it, with a splice."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated

import numpy as np
from pydantic import Field

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.faults.base import Degrees, GrowingFault, Millimetres, Seed, Share
from beltscape.simulate.geometry.world import Label, Solid
from beltscape.simulate.solids.belt import BeltSettings
from beltscape.simulate.solids.fines import HeightField, make_fines_mesh
from beltscape.simulate.solids.material import ReflectanceModel, make_fines_solid

_CELL_MM = 4.0
"""Spacing of the height field of what sticks to the belt."""
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
