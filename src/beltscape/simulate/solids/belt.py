"""The empty belt as a solid: a three-roll trough of black rubber, and the floor below it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.quantities import BELT_WIDTH
from beltscape.simulate.shapes import extrude, triangulate_height_field
from beltscape.simulate.world import Label, Solid

Millimetres = Annotated[float, Field(gt=0, le=1e5, allow_inf_nan=False)]
Reflectance = Annotated[float, Field(ge=0, le=1)]
_ARC_STEP = np.deg2rad(1.0)
"""Angle of a facet of a fold."""
_SAG_STEP_MM = 20.0
"""Length of a facet of a sagging belt."""


class BeltSettings(BaseModel):
    """The belt on sets of three idlers: a level middle and a wing on each side. z = 0 is the middle under the rig."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    flat_mm: Millimetres = 300.0
    """Distance between the fold lines, measured as if the folds were sharp."""
    wing_deg: Annotated[float, Field(ge=0, le=75)] = 25.0
    """Angle of the wings to the horizontal."""
    width_mm: Annotated[float, BELT_WIDTH] = 800.0
    """Width of the belt, measured along its surface."""
    fold_radius_mm: Annotated[float, Field(ge=0, le=1000)] = 40.0
    """Radius of the bend between the middle roll and the wings; reduced where there is no room for it."""
    thickness_mm: Millimetres = 12.0
    length_mm: Annotated[float, BELT_WIDTH] = 1600.0
    """Length of the modelled piece of belt; half of it lies on each side of the rig."""
    misaligned_mm: Annotated[float, Field(ge=-500, le=500)] = 0.0
    """Lateral misalignment of the belt towards +x on its idlers: one edge climbs, the trough stays."""
    sag_mm: Annotated[float, Field(ge=0, le=100)] = 0.0
    """Sag of the belt halfway between two sets of idlers."""
    idler_pitch_mm: Millimetres = 1200.0
    """Distance between sets of idlers; one set stands under the rig."""
    floor_mm: Millimetres = 700.0
    """Height of the belt's middle above the floor."""
    reflectance: Reflectance = 0.05
    """Diffuse reflectance of the belt (black rubber)."""
    floor_reflectance: Reflectance = 0.2

    @model_validator(mode="after")
    def _check_wings(self) -> BeltSettings:
        if self._wing_mm(-1) <= 0 or self._wing_mm(1) <= 0:
            raise ValueError(
                f"width_mm = {self.width_mm:g} leaves no wing beside flat_mm = {self.flat_mm:g} "
                f"with misaligned_mm = {self.misaligned_mm:g}; widen the belt or narrow its flat"
            )
        return self

    def _wing_mm(self, side: int) -> float:
        """Return the length of a wing, measured along sharp folds."""
        return (self.width_mm - self.flat_mm) / 2 + side * self.misaligned_mm

    @property
    def section_mm(self) -> NDArray[np.float64]:
        """Return (K, 2) x, z of the belt's upper side under the rig, from left to right, exactly as in the mesh."""
        angle, half = np.deg2rad(self.wing_deg), self.flat_mm / 2
        # a fold of radius r begins r·tan(angle/2) before the fold line and must end on the shorter wing
        room = 0.9 * min(half, self._wing_mm(-1), self._wing_mm(1))
        cut = min(self.fold_radius_mm * np.tan(angle / 2), room)
        if cut > 0:
            radius = cut / np.tan(angle / 2)
            angles = np.linspace(0, float(angle), int(np.ceil(angle / _ARC_STEP)) + 1)
            fold = np.column_stack([half - cut + radius * np.sin(angles), radius * (1 - np.cos(angles))])
            shortening = 2 * cut - radius * angle  # the arc is shorter than the sharp corner
        else:
            fold, shortening = np.array([[half, 0.0]]), 0.0
        wing = np.array([np.cos(angle), np.sin(angle)])
        left, right = ([half, 0] + wing * (self._wing_mm(side) + shortening) for side in (-1, 1))
        return np.concatenate([np.array([left, *fold[::-1]]) * [-1, 1], fold, [right]])

    @property
    def straight_wing_mm(self) -> float:
        """Return the length of the shorter wing beyond its fold."""
        ends = np.diff(self.section_mm[[0, 1, -2, -1]], axis=0)[[0, 2]]
        return float(np.linalg.norm(ends, axis=1).min())

    @property
    def half_width_mm(self) -> tuple[float, float]:
        """Return the positions of the belt's edges: −x of the left one, x of the right one."""
        section = self.section_mm
        return -float(section[0, 0]), float(section[-1, 0])

    def height_at(self, x_mm: ArrayLike, y_mm: ArrayLike = 0.0) -> NDArray[np.float64]:
        """Return the height of the upper side at x, y (broadcast), mm, equal to the mesh's; NaN beside the belt."""
        x, y = np.broadcast_arrays(np.asarray(x_mm, float), np.asarray(y_mm, float))
        section, along = self.section_mm, self.along_mm
        z = np.interp(x, section[:, 0], section[:, 1], left=np.nan, right=np.nan)
        return z - np.interp(y, along, self.sag_at(along), left=np.nan, right=np.nan)

    @property
    def along_mm(self) -> NDArray[np.float64]:
        """Return (N,) y of the mesh's cross-sections."""
        half = self.length_mm / 2
        if self.sag_mm == 0:
            return np.array([-half, half])
        return np.linspace(-half, half, int(np.ceil(self.length_mm / _SAG_STEP_MM)) + 1)

    def sag_at(self, y_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the depth of the sag at y: smooth, 0 at the idlers."""
        return self.sag_mm * np.sin(np.pi * y_mm / self.idler_pitch_mm) ** 2


@dataclass(frozen=True, slots=True, eq=False)
class EdgeNotches:
    """Material missing at the belt's edges, by cross-section."""

    along_mm: NDArray[np.float64]
    """(N,) y of cross-sections, ascending; between them the notches vary linearly."""
    left_mm: NDArray[np.float64]
    """(N,) width that is missing at the left edge, along the belt's surface."""
    right_mm: NDArray[np.float64]
    """(N,) the same at the right edge."""


def make_belt_solids(settings: BeltSettings, notches: EdgeNotches | None = None) -> tuple[Solid, Solid]:
    """Return the belt, a closed slab with the upper side `BeltSettings.height_at`, and the floor, a rectangle.

    ``notches`` shorten its wings, by less than their straight parts.
    """
    top, along = settings.section_mm, settings.along_mm
    sag = settings.sag_at(along)
    if notches is not None:
        every = np.union1d(along, np.clip(notches.along_mm, along[0], along[-1]))
        along, sag = every, np.interp(every, along, sag)
    step = np.gradient(top, axis=0)
    down = np.column_stack([step[:, 1], -step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    down[[0, -1]] = [
        0.0,
        -1 / np.cos(np.deg2rad(settings.wing_deg)),
    ]  # cut vertically: the edge is invisible from above
    mesh = extrude(np.concatenate([top, (top + settings.thickness_mm * down)[::-1]]), along)
    sections = np.arange(len(mesh.vertices_mm)) // (2 * len(top))
    vertices = mesh.vertices_mm - np.outer(sag[sections], [0, 0, 1])
    if notches is not None:
        vertices = _cut_edges(vertices.reshape(len(along), 2 * len(top), 3), settings, notches).reshape(-1, 3)
    belt = Solid("belt", Label.BELT, vertices, mesh.faces, _grey(settings.reflectance))
    reach = np.array([-3.0, 3.0]) * max(settings.width_mm, settings.length_mm)
    floor_mesh = triangulate_height_field(reach, reach, np.full((2, 2), -settings.floor_mm))
    floor = Solid(
        "floor", Label.FLOOR, floor_mesh.vertices_mm, floor_mesh.faces, _grey(settings.floor_reflectance)
    )
    return belt, floor


def _cut_edges(
    vertices_mm: NDArray[np.float64], settings: BeltSettings, notches: EdgeNotches
) -> NDArray[np.float64]:
    """Return the vertices (N, 2·K, 3) of cross-sections with upper and lower edges moved inwards on the wings."""
    angle, count = np.deg2rad(settings.wing_deg), vertices_mm.shape[1]
    cut, along = vertices_mm.copy(), vertices_mm[:, 0, 1]
    left, right = (0, count - 1), (count // 2 - 1, count // 2)
    for edge, missing, side in ((left, notches.left_mm, -1.0), (right, notches.right_mm, 1.0)):
        width = np.interp(along, notches.along_mm, missing, left=0.0, right=0.0)
        inwards = np.outer(width, [-side * np.cos(angle), 0.0, -np.sin(angle)])
        cut[:, edge] += inwards[:, None]
    return cut


def _grey(reflectance: float) -> tuple[float, float, float]:
    return reflectance, reflectance, reflectance
