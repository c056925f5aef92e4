"""The markers of several cameras held against each other through the rig: same labels, same places."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from beltscape.core.rig import Rig
from beltscape.kernels import Kernels, load
from beltscape.stereo.markers.grid import SIDE, MarkerGrid
from beltscape.stereo.multiview.initialisation.depth_range import search_range

_OFF_RADII = 0.3
"""How far from where the others put it a camera may see a marker, in its radii. Half a disc hidden shifts the
centroid of the rest by 0.42."""
_OFF_PX = 2.0
"""And in px, for small discs: the rig and the centroid are no better."""
_LEAST, _SHARE = 4, 0.7
"""Markers that must meet for a labelling to be believed, and how many of the common ones: four of five by chance is
rarer than one in a thousand."""


def agree(grids: Mapping[str, MarkerGrid], rig: Rig) -> dict[str, MarkerGrid]:
    """The same rows and columns in all cameras: those of the camera that found most, the core of equals.

    Every other grid is turned (0, 90, 180, 270°) and, where whole rows or columns are missing, shifted so that most
    markers meet in space; a grid for which hardly any do is left out.
    """
    if not grids:
        return {}
    kernels = load()
    reference = max(grids, key=lambda name: (grids[name].count, name == rig.core))
    agreed = {reference: grids[reference]}
    for name in grids:
        if name == reference:
            continue
        best, best_score = None, (0, 0.0)
        for option in grids[name].placements():
            met, off, common = _meeting({reference: grids[reference], name: option}, rig, kernels)
            if met >= max(_LEAST, _SHARE * common) and (met, -off) > best_score:
                best, best_score = option, (met, -off)
        if best is not None:
            agreed[name] = best
    return {name: agreed[name] for name in grids if name in agreed}


def seen_in_place(
    grids: Mapping[str, MarkerGrid], rig: Rig, kernels: Kernels
) -> tuple[NDArray[np.float64], dict[str, NDArray[np.bool_]]]:
    """Markers in space, (16, 3) in the core's frame, mm, NaN where not believed; by camera (16,) which it saw there.

    Each is triangulated from all cameras that found it; while one of them sees it too far from there, the farthest
    is dropped. What is left must be the core and another camera.
    """
    names = list(grids)
    pixels = np.stack([_undistorted(grids[name], rig, name) for name in names])
    limit = np.stack([_limit_px(grids[name]) for name in names])
    while True:
        points = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
        off = _off_px(points, pixels, rig, names) / limit
        worst = np.argmax(np.nan_to_num(off, nan=-1.0), axis=0)
        columns = np.flatnonzero(np.nan_to_num(off, nan=-1.0).max(axis=0, initial=-1.0) > 1)
        if not columns.size:
            break
        pixels[worst[columns], columns] = np.nan
    used: NDArray[np.bool_] = np.asarray(np.isfinite(pixels).all(axis=-1))
    believed = used[names.index(rig.core)] & (used.sum(axis=0) >= 2) & (points[:, 2] > 0)
    points = np.where(believed[:, None], points, np.nan)
    return points, {name: used[i] & believed for i, name in enumerate(names)}


def _meeting(grids: Mapping[str, MarkerGrid], rig: Rig, kernels: Kernels) -> tuple[int, float, int]:
    """Of two cameras: how many markers meet in space before both, how far off these are (px), how many both see."""
    names = list(grids)
    pixels = np.stack([_undistorted(grids[name], rig, name) for name in names])
    points = kernels.triangulate(np.stack([rig.projection(name) for name in names]), pixels)
    off = _off_px(points, pixels, rig, names)
    limit = np.stack([_limit_px(grids[name]) for name in names])
    near, far = search_range(rig, rig.auxiliaries)
    met = (off < limit).all(axis=0) & (points[:, 2] > near) & (points[:, 2] < far)
    common = int(np.isfinite(pixels).all(axis=(0, 2)).sum())
    return int(met.sum()), float(off[:, met].mean()) if met.any() else np.inf, common


def _undistorted(grid: MarkerGrid, rig: Rig, name: str) -> NDArray[np.float64]:
    """(16, 2) undistorted pixels; NaN where not found."""
    camera = rig.cameras[name]
    pixels = camera.undistort(grid.center_px.reshape(-1, 2)) * camera.focal_px + camera.center_px
    pixels[~grid.found.reshape(-1)] = np.nan
    return pixels


def _limit_px(grid: MarkerGrid) -> NDArray[np.float64]:
    """(16,) how far from its place each may be seen."""
    typical = float(np.nanmedian(grid.radius_px))
    return np.full(SIDE * SIDE, max(_OFF_PX, _OFF_RADII * typical))


def _off_px(
    points_mm: NDArray[np.float64], pixels: NDArray[np.float64], rig: Rig, names: list[str]
) -> NDArray[np.float64]:
    """(n, N) distance between undistorted pixels and where each camera would see the points; inf behind a camera."""
    off = []
    for name, seen in zip(names, pixels, strict=True):
        local = rig.cam_from_core[name].apply(points_mm)
        camera = rig.cameras[name]
        with np.errstate(divide="ignore", invalid="ignore"):
            expected = local[:, :2] / local[:, 2:] * camera.focal_px + camera.center_px
        distance = np.linalg.norm(expected - seen, axis=-1)
        off.append(np.where(local[:, 2] > 0, distance, np.where(np.isfinite(distance), np.inf, np.nan)))
    return np.array(off)
