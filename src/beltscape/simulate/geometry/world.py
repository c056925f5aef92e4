"""What is simulated: solids on a belt, the cameras over it, the projector that lights it.

World frame: x across the belt, y along it, z up, mm; the origin lies on the empty flat belt under the rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.core.rig import Rig


class Label(IntEnum):
    """What a pixel shows. A module's features count up from FEATURE, in the order of module.toml."""

    NOTHING = 0
    BELT = 1
    MATERIAL = 2
    FLOOR = 3
    BOARD = 4
    BASE = 10
    FEATURE = 11


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A closed or open triangle mesh of one material."""

    name: str
    label: int
    vertices_mm: NDArray[np.float64]
    """(V, 3) in the world frame."""
    faces: NDArray[np.int64]
    """(F, 3) vertex indices, counter-clockwise seen from outside."""
    reflectance: tuple[float, float, float]
    """Diffuse, linear RGB, 0..1; where there is a texture, its factor."""
    texture: NDArray[np.float32] | None = None
    """(h, w, 3) linear RGB 0..1."""
    uv: NDArray[np.float64] | None = None
    """(V, 2) texture coordinates; u to the right, v down, (0, 0) at the outer corner of the top-left texel."""
    gloss: float = 0.0
    """Share of light that is reflected as by a rough plastic surface; 0: purely diffuse."""

    def shift(self, along_mm: float) -> Solid:
        """The same after the belt has carried it that far along +y."""
        return replace(self, vertices_mm=self.vertices_mm + np.array([0.0, along_mm, 0.0]))


@dataclass(frozen=True, slots=True, eq=False)
class Projector:
    """A pinhole that sends light: the pattern's pixel (0, 0) is the centre of its top-left pixel."""

    camera: Camera
    projector_from_world: Pose
    pattern: NDArray[np.float32]
    """(H, W, 3) linear RGB 0..1, as the lens lets it out (blur included)."""
    power: float
    """Irradiance of a white pixel on a surface facing it at 1000 mm, in units of the ambient light's."""


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A rig over the belt."""

    rig: Rig
    core_from_world: Pose

    def cam_from_world(self, name: str) -> Pose:
        """Of one camera."""
        return self.rig.cam_from_core[name] @ self.core_from_world


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """One instant."""

    solids: tuple[Solid, ...]
    projector: Projector | None
    """None: its light is off."""
    ambient: float = 1.0
    """Factor on the diffuse light of the hall."""
