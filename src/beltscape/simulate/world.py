"""The simulated world: solids on a belt, the cameras above it, and the projector that lights it.

World frame: x across the belt, y along it, z up, mm; the origin lies on the empty level belt under the rig.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig


class Label(IntEnum):
    """The class of a surface. A module's features count up from FEATURE, in the order of module.toml."""

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
    """Diffuse, linear RGB, 0..1; multiplied by the texture where there is one."""
    texture: NDArray[np.float32] | None = None
    """(h, w, 3) linear RGB 0..1."""
    uv: NDArray[np.float64] | None = None
    """(V, 2) texture coordinates; u to the right, v down, (0, 0) at the outer corner of the top-left texel."""
    gloss: float = 0.0
    """Share of the light that is reflected as by a rough plastic surface; 0: purely diffuse."""

    def shift(self, along_mm: float) -> Solid:
        """Return the solid after the belt has carried it by ``along_mm`` towards +y."""
        return replace(self, vertices_mm=self.vertices_mm + np.array([0.0, along_mm, 0.0]))


@dataclass(frozen=True, slots=True, eq=False)
class Projector:
    """A pinhole projector; (0, 0) is the centre of the pattern's top-left pixel."""

    camera: Camera
    projector_from_world: Pose
    pattern: NDArray[np.float32]
    """(H, W, 3) linear RGB 0..1 behind the lens (blur included)."""
    power: float
    """Irradiance of a white pixel on a surface facing it at 1000 mm, in units of the ambient light."""


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A rig and its pose above the belt."""

    rig: Rig
    core_from_world: Pose

    def cam_from_world(self, name: str) -> Pose:
        """Return the pose of one camera."""
        return self.rig.cam_from_core[name] @ self.core_from_world


@dataclass(frozen=True, slots=True, eq=False)
class World:
    """The world at one instant."""

    solids: tuple[Solid, ...]
    projector: Projector | None
    """None: the projector is off."""
    ambient: float = 1.0
    """Factor on the diffuse ambient light of the hall."""
