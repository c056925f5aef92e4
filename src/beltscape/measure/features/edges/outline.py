"""Faces by their edges: the length and width of a rectangle, the diameter of a circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.camera import Camera
from beltscape.core.pose import Pose
from beltscape.measure.features.edges.band import OnFace, on_face, round_band, straight_band
from beltscape.measure.features.edges.edge import Edge, locate
from beltscape.measure.features.face import Face
from beltscape.measure.features.pose.nominal import NominalView
from beltscape.measure.features.result import EdgeLine

_TILTS_PX = np.linspace(-0.6, 0.6, 7)[:, None]
_SHIFTS_PX = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 7)] * 2), axis=-1).reshape(-1, 2)


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """What edges are looked for in."""

    camera: Camera
    depth_mm: NDArray[np.float32]
    """(H, W)."""
    grey: NDArray[np.float32] | None
    """(H, W) brightness of the still scene in the core camera, on its undistorted grid."""
    view: NominalView
    core_from_module: Pose


@dataclass(frozen=True, slots=True)
class Extent:
    """A measured length across a face."""

    length_mm: float
    sigma_mm: float
    points: int


def rectangle(
    scene: Scene, name: str, label: int, face: Face, place: NDArray[np.float64], size_mm: tuple[float, float]
) -> tuple[tuple[Extent | None, Extent | None], list[EdgeLine]]:
    """Extents along the module's x and y of a face around ``place`` (3,) mm; None where an edge is missing."""
    half = size_mm[0] / 2, size_mm[1] / 2
    plane = _plane(scene, face, place, float(np.hypot(*half)))
    extents: list[Extent | None] = []
    lines: list[EdgeLine] = []
    for axis in (0, 1):
        pair: list[tuple[Edge, float]] = []
        for sign in (1, -1):
            band = straight_band(plane, scene.view, label, scene.depth_mm, half, axis, sign)
            edge = band and locate(band, scene.grey, _TILTS_PX)
            if band is None or edge is None:
                continue
            pair.append((edge, band.px_mm))
            found, perfect = (
                _on_face(scene, face, place, _ends(half, axis, sign, offset, tilt))
                for offset, tilt in ((edge.offset_px * band.px_mm, edge.nuisance[0] * band.px_mm), (0.0, 0.0))
            )
            lines.append(EdgeLine(name, found, perfect, edge.sigma_px * band.px_mm, edge.by_image))
        extents.append(_extent(size_mm[axis], pair) if len(pair) == 2 else None)
    return (extents[0], extents[1]), lines


def circle(
    scene: Scene, name: str, label: int, face: Face, place: NDArray[np.float64], diameter_mm: float
) -> tuple[Extent | None, list[EdgeLine]]:
    """Diameter of a round face around ``place`` (3,) mm; None where its rim is not seen."""
    plane = _plane(scene, face, place, diameter_mm / 2)
    band = round_band(plane, scene.view, label, scene.depth_mm, diameter_mm / 2)
    edge = band and locate(band, scene.grey, _SHIFTS_PX)
    if band is None or edge is None:
        return None, []
    angle = np.linspace(-np.pi, np.pi, 73)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    moved = ring * (diameter_mm / 2 + edge.offset_px * band.px_mm) + edge.nuisance * band.px_mm
    lines = [_on_face(scene, face, place, flat) for flat in (moved, ring * diameter_mm / 2)]
    sigma = 2 * edge.sigma_px * band.px_mm
    extent = Extent(diameter_mm + 2 * edge.offset_px * band.px_mm, sigma, edge.points)
    return extent, [EdgeLine(name, *lines, sigma / 2, edge.by_image)]


def _plane(scene: Scene, face: Face, place: NDArray[np.float64], half_mm: float) -> OnFace:
    pose = scene.core_from_module
    axes = pose.rotation[:, 0], pose.rotation[:, 1]
    return on_face(face, scene.camera, pose.apply(place), axes, half_mm)


def _extent(nominal_mm: float, pair: list[tuple[Edge, float]]) -> Extent:
    length = nominal_mm + sum(edge.offset_px * px for edge, px in pair)
    own = sum((edge.sigma_px**2 - edge.common_px**2) * px**2 for edge, px in pair)
    common = sum(edge.common_px * px for edge, px in pair)  # the rim reaches alike on both sides
    sigma = float(np.sqrt(max(own, 0.0) + common**2))
    return Extent(length, sigma, sum(edge.points for edge, _ in pair))


def _ends(half: tuple[float, float], axis: int, sign: int, offset: float, tilt: float) -> NDArray[np.float64]:
    """(2, 2) both ends of an edge on the face, mm, moved outwards by ``offset`` -+ ``tilt``."""
    flat = np.empty((2, 2))
    flat[:, 1 - axis] = [-half[1 - axis], half[1 - axis]]
    flat[:, axis] = sign * (half[axis] + offset + tilt * np.array([-1.0, 1.0]))
    return flat


def _on_face(
    scene: Scene, face: Face, place: NDArray[np.float64], flat: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(n, 3) in the core's frame of places (n, 2) mm about ``place``, brought onto the face."""
    points = scene.core_from_module.apply(np.column_stack([flat + place[:2], np.full(len(flat), place[2])]))
    off = (1 - points @ face.q) / float(np.linalg.norm(face.q))
    return points - off[:, None] * face.normal
