"""Dimensions of faces from their edges: the length and width of a rectangle, the diameter of a circle."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.measure.features.edges.band import (
    FaceCoordinates,
    compute_face_coordinates,
    make_round_band,
    make_straight_band,
)
from beltscape.measure.features.edges.edge import Edge, locate_edge
from beltscape.measure.features.face import Face
from beltscape.measure.features.pose.nominal import NominalView
from beltscape.measure.features.result import EdgeLine

_TILTS_PX = np.linspace(-0.6, 0.6, 7)[:, None]
"""Displacements of the end of a line that are tried."""
_SHIFTS_PX = np.stack(np.meshgrid(*[np.linspace(-0.6, 0.6, 7)] * 2), axis=-1).reshape(-1, 2)
"""Shifts of a circle that are tried, in columns and rows."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeScene:
    """The frame and the nominal module in which edges are located."""

    camera: Camera
    depth_mm: NDArray[np.float32]
    """(H, W)."""
    grey: NDArray[np.float32] | None
    """(H, W) brightness of the static scene in the core camera, on its undistorted grid."""
    view: NominalView
    core_from_module: Pose


@dataclass(frozen=True, slots=True)
class Extent:
    """A measured length across a face."""

    length_mm: float
    sigma_mm: float
    points: int


def measure_rectangle(
    scene: EdgeScene,
    name: str,
    label: int,
    face: Face,
    center: NDArray[np.float64],
    size_mm: tuple[float, float],
) -> tuple[tuple[Extent | None, Extent | None], list[EdgeLine]]:
    """Measure the extents in the module's x and y of a face centred at ``center`` (3,) mm; None without an edge."""
    half = size_mm[0] / 2, size_mm[1] / 2
    plane = _make_coordinates(scene, face, center, float(np.hypot(*half)))
    extents: list[Extent | None] = []
    lines: list[EdgeLine] = []
    for axis in (0, 1):
        pair: list[tuple[Edge, float]] = []
        for sign in (1, -1):
            band = make_straight_band(plane, scene.view, label, scene.depth_mm, half, axis, sign)
            edge = band and locate_edge(band, scene.grey, _TILTS_PX)
            if band is None or edge is None:
                continue
            pair.append((edge, band.px_mm))
            located, nominal = (
                _project_onto_face(scene, face, center, _compute_edge_ends(half, axis, sign, offset, tilt))
                for offset, tilt in ((edge.offset_px * band.px_mm, edge.nuisance[0] * band.px_mm), (0.0, 0.0))
            )
            lines.append(EdgeLine(name, located, nominal, edge.sigma_px * band.px_mm, edge.by_image))
        extents.append(_make_extent(size_mm[axis], pair) if len(pair) == 2 else None)
    return (extents[0], extents[1]), lines


def measure_circle(
    scene: EdgeScene, name: str, label: int, face: Face, center: NDArray[np.float64], diameter_mm: float
) -> tuple[Extent | None, list[EdgeLine]]:
    """Measure the diameter of a round face centred at ``center`` (3,) mm; None where its edge is not visible."""
    plane = _make_coordinates(scene, face, center, diameter_mm / 2)
    band = make_round_band(plane, scene.view, label, scene.depth_mm, diameter_mm / 2)
    edge = band and locate_edge(band, scene.grey, _SHIFTS_PX)
    if band is None or edge is None:
        return None, []
    angle = np.linspace(-np.pi, np.pi, 73)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    located = ring * (diameter_mm / 2 + edge.offset_px * band.px_mm) + edge.nuisance * band.px_mm
    measured, nominal = (
        _project_onto_face(scene, face, center, flat) for flat in (located, ring * diameter_mm / 2)
    )
    sigma = 2 * edge.sigma_px * band.px_mm
    extent = Extent(diameter_mm + 2 * edge.offset_px * band.px_mm, sigma, edge.points)
    return extent, [EdgeLine(name, measured, nominal, sigma / 2, edge.by_image)]


def _make_coordinates(
    scene: EdgeScene, face: Face, center: NDArray[np.float64], half_mm: float
) -> FaceCoordinates:
    pose = scene.core_from_module
    axes = pose.rotation[:, 0], pose.rotation[:, 1]
    return compute_face_coordinates(face, scene.camera, pose.apply(center), axes, half_mm)


def _make_extent(nominal_mm: float, pair: list[tuple[Edge, float]]) -> Extent:
    length = nominal_mm + sum(edge.offset_px * px for edge, px in pair)
    own = sum((edge.sigma_px**2 - edge.common_px**2) * px**2 for edge, px in pair)
    common = sum(edge.common_px * px for edge, px in pair)  # the rim's bias is the same on both sides
    sigma = float(np.sqrt(max(own, 0.0) + common**2))
    return Extent(length, sigma, sum(edge.points for edge, _ in pair))


def _compute_edge_ends(
    half: tuple[float, float], axis: int, sign: int, offset: float, tilt: float
) -> NDArray[np.float64]:
    """Return both ends (2, 2) of an edge on the face, mm, displaced outwards by ``offset`` -+ ``tilt``."""
    flat = np.empty((2, 2))
    flat[:, 1 - axis] = [-half[1 - axis], half[1 - axis]]
    flat[:, axis] = sign * (half[axis] + offset + tilt * np.array([-1.0, 1.0]))
    return flat


def _project_onto_face(
    scene: EdgeScene, face: Face, center: NDArray[np.float64], flat: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return points (n, 3) in the core's frame, on the face, of positions (n, 2) mm relative to ``center``."""
    points = scene.core_from_module.apply(np.column_stack([flat + center[:2], np.full(len(flat), center[2])]))
    off = (1 - points @ face.q) / float(np.linalg.norm(face.q))
    return points - off[:, None] * face.normal
