"""The drift of a plant's rig, from its history: what changed, its proposal, and what that would change in litres."""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from beltscape.calibration.assessment.covariance import (
    POSE_NAMES,
    compute_depth_jacobian,
    count_parameters,
    list_parameter_columns,
)
from beltscape.core.arrays import Array
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError
from beltscape.core.geometry.lens import list_intrinsics
from beltscape.core.geometry.pose import vector_from_rotation
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter
from beltscape.files.json_text import hash_file
from beltscape.files.rig_json import read_rig
from beltscape.pipeline.live.project import Project, RunSettings
from beltscape.pipeline.measuring.belt import read_empty_belt
from beltscape.production.sums import ProductionSums, add_up
from beltscape.sinks.historian.drift import StoredDrift, read_drifts, read_first_drift
from beltscape.sinks.historian.production import read_product_sums
from beltscape.sinks.historian.reading import find_database, read_history
from beltscape.stereo.consistency.drift import NOTHING, PARAMETERS, apply_drift

FORMAT = "beltscape-drift/1"
MOST_ESTIMATES = 2000
"""Newest estimates that are read: half a year of one every two hours."""
COMPARED_NS = 7 * 24 * 3600 * 10**9
"""Period before the newest estimate over which the litres are stated: a week."""
_STEPS = np.array([1e-6, 1e-6, 1e-6, 1e-3, 1e-3, 1e-3, 1e-6])
_SIGMAS = 2.0
"""A change of the volume below this many σ is not known to be one; the report says so."""


@dataclass(frozen=True, slots=True, eq=False)
class VolumeEffect:
    """What a proposed rig would change in what is measured, with σ."""

    share: float
    """Relative change of the volume with the zero as it is."""
    sigma: float
    share_after_zero: float
    """The same once the zero is set, which takes up what is alike in belt and load."""
    sigma_after_zero: float


@dataclass(frozen=True, slots=True, eq=False)
class RigDrift:
    """The drift of a plant's present rig."""

    rig_path: Path
    digest: str
    """SHA-256 of the rig's file."""
    estimates: tuple[StoredDrift, ...]
    """Oldest first; without the reference window."""
    began_ns: int | None
    """End of the reference window; None before it."""
    proposed: Rig | None
    """By the newest estimate; None where nothing has moved."""
    effects: tuple[VolumeEffect, ...]
    """Of each estimate."""
    volume_mm3: float
    """What was measured in the week before the newest estimate."""
    window_s: float
    """Running time that an estimate is of, by the present settings; 0: none is made."""

    @property
    def newest(self) -> StoredDrift | None:
        """Return the newest estimate; None without one."""
        return self.estimates[-1] if self.estimates else None


def assess_drift(project: Project[RunSettings], reporter: Reporter) -> RigDrift:
    """Return the drift of a project's rig, from a history that a plant may be writing.

    Raises
    ------
    InputError
        If there is no history, or rig or empty belt cannot be read.
    """
    settings = project.settings
    rig_path = project.resolve(settings.rig)
    rig, digest = read_rig(rig_path), hash_file(rig_path)

    def read(connection: sqlite3.Connection) -> tuple[list[StoredDrift], StoredDrift | None, ProductionSums]:
        found, first = read_drifts(connection, digest, MOST_ESTIMATES), read_first_drift(connection, digest)
        last_ns = found[-1].wall_ns if found else 0
        return found, first, add_up(read_product_sums(connection, last_ns - COMPARED_NS, last_ns))

    found, first, sums = read_history(find_database(project.resolve(settings.data)), read)
    estimates = tuple(one for one in found if "moved" in one.document)
    effects: tuple[VolumeEffect, ...] = ()
    if estimates:
        belt, _ = read_empty_belt(project.resolve(settings.empty), reporter, settings.belt)
        height_mm = _find_load_height(sums, belt)
        gains = differentiate_volume(rig, belt, height_mm)
        effects = tuple(_compute_effect(gains, one.document) for one in estimates)
    proposed = propose_rig(rig, estimates[-1].document) if estimates else None
    began_ns = None if first is None else first.wall_ns
    window_s = settings.watch.drift_every_s * settings.watch.drift_frames
    return RigDrift(rig_path, digest, estimates, began_ns, proposed, effects, sums.volume_mm3, window_s)


_TYPICAL_SHARE = 0.1
"""Height of the load over the belt's width where none was measured. Chosen."""


def _find_load_height(sums: ProductionSums, belt: Belt) -> float:
    """Return the mean height of the load, mm."""
    width_mm = belt.across_mm[1] - belt.across_mm[0]
    measured_mm = sums.valid_mm + sums.degraded_mm
    height_mm = sums.volume_mm3 / (measured_mm * width_mm) if measured_mm else 0.0
    return height_mm if height_mm > 0 else _TYPICAL_SHARE * width_mm


def propose_rig(rig: Rig, document: Mapping[str, Any]) -> Rig | None:
    """Return the rig after the change of an estimate, with its covariance added; None where nothing has moved."""
    if document["moved"] == NOTHING:
        return None
    changes = _read_changes(document)
    moved = apply_drift(rig, {name: change for name, change in changes.items() if np.any(change)})
    parameters = [str(name) for name in rig.covariance.get("parameters") or ()]
    names = _list_parameters(rig)
    if sorted(parameters) != sorted(names):
        return moved
    by_change = differentiate_parameters(rig, tuple(changes))[[names.index(one) for one in parameters]]
    added = by_change @ np.array(document["covariance"], np.float64) @ by_change.T
    matrix = np.asarray(rig.covariance["matrix"], np.float64) + added
    return replace(moved, covariance={**rig.covariance, "matrix": matrix.tolist()})


def _read_changes(document: Mapping[str, Any]) -> dict[str, Array]:
    rows = np.array(document["change"], np.float64).reshape(-1, len(PARAMETERS))
    return dict(zip(document["cameras"], rows, strict=True))


def _list_parameters(rig: Rig) -> list[str]:
    lenses = [f"{name}.{one}" for name, each in rig.cameras.items() for one in list_intrinsics(each.model)]
    return lenses + [f"{name}.{one}" for name in rig.cameras if name != rig.core for one in POSE_NAMES]


def differentiate_parameters(rig: Rig, cameras: tuple[str, ...]) -> Array:
    """Return the derivatives (G, 7·C) of a rig's parameters by the changes of its cameras, in their given order."""
    columns: list[Array] = []
    for camera in cameras:
        for index, step in enumerate(_STEPS):
            change = np.zeros(len(PARAMETERS))
            change[index] = step
            columns.append(_subtract(apply_drift(rig, {camera: change}), rig) / step)
    return np.stack(columns, axis=1)


def _subtract(moved: Rig, rig: Rig) -> Array:
    """Return the difference (G,) of the parameters of two rigs of the same cameras."""
    difference = np.zeros(count_parameters(rig))
    for index, name in enumerate(rig.cameras):
        own = list_parameter_columns(rig, index)
        difference[own[:2]] = moved.cameras[name].focal_px - rig.cameras[name].focal_px
        if name != rig.core:
            pose, before = moved.cam_from_core[name], rig.cam_from_core[name]
            turn = vector_from_rotation(pose.rotation @ before.rotation.T)
            difference[own[-6:]] = np.concatenate([turn, pose.translation_mm - before.translation_mm])
    return difference


_GRID = 9
"""Points across and along of the surfaces on which the volume's change is averaged."""


def differentiate_volume(rig: Rig, belt: Belt, height_mm: float) -> Array:
    """Return the derivatives (2, 7·C) of the volume's relative change by a rig's change.

    The first row is with the zero as it is, the second with the zero set afterwards. The load is even,
    ``height_mm`` high. The cameras are the core, then the auxiliaries.
    """
    by_change = differentiate_parameters(rig, (rig.core, *rig.auxiliaries))
    heights = [_average_rise(rig, belt, level) @ by_change for level in (height_mm, 0.0)]
    return np.stack([heights[0], heights[0] - heights[1]]) / height_mm


def _average_rise(rig: Rig, belt: Belt, level_mm: float) -> Array:
    """Return the derivatives (G,) of the mean height of a level surface by the rig's parameters."""
    x, y = (np.linspace(*extent, _GRID) for extent in (belt.across_mm, belt.along_mm))
    place = np.stack([*np.meshgrid(x, y), np.full((_GRID, _GRID), level_mm)], axis=-1).reshape(-1, 3)
    points = belt.belt_from_core.inverse().apply(place)
    jacobian = compute_depth_jacobian(rig, points)
    visible = np.isfinite(jacobian).all(axis=1)
    if not visible.any():
        raise InputError(
            "the rig sees nothing of the empty belt; give the rig and the empty belt of this plant"
        )
    rays = points[visible] / points[visible, 2:]
    rise = rays @ belt.belt_from_core.rotation[2]
    return np.asarray((rise[:, None] * jacobian[visible]).mean(axis=0), np.float64)


def _compute_effect(gains: Array, document: Mapping[str, Any]) -> VolumeEffect:
    change = np.array(document["change"], np.float64)
    covariance = np.array(document["covariance"], np.float64)
    share, later = gains @ change
    sigma, sigma_later = np.sqrt(np.einsum("ij,jk,ik->i", gains, covariance, gains))
    return VolumeEffect(float(share), float(sigma), float(later), float(sigma_later))


def make_drift_document(found: RigDrift) -> dict[str, Any]:
    """Return the drift as plain values."""
    newest = found.newest
    effect = found.effects[-1] if found.effects else None
    litres = found.volume_mm3 * 1e-6
    return {
        "format": FORMAT,
        "rig": str(found.rig_path),
        "rig_sha256": found.digest,
        "reference_ns": found.began_ns,
        "window_s": found.window_s,
        "estimates": [
            _describe_estimate(one, each) for one, each in zip(found.estimates, found.effects, strict=True)
        ],
        "newest": None if newest is None else newest.number,
        "moved": None if newest is None else newest.document["moved"],
        "has_proposal": found.proposed is not None,
        "needs_new_belt": found.proposed is not None and newest is not None and _moves_core(newest, found),
        "week_litres": litres,
        "change_litres": effect.share * litres if effect and litres else None,
        "change_sigma_litres": effect.sigma * litres if effect and litres else None,
        "is_significant": effect is not None and abs(effect.share) > _SIGMAS * effect.sigma,
    }


def _moves_core(newest: StoredDrift, found: RigDrift) -> bool:
    """Return whether the core camera moved, and with it the belt's place in its frame."""
    core = newest.document["cameras"][0]
    return bool(np.any(_read_changes(newest.document)[core][:6])) and found.proposed is not None


def _describe_estimate(one: StoredDrift, effect: VolumeEffect) -> dict[str, Any]:
    document = one.document
    sigmas = np.sqrt(np.diag(np.array(document["covariance"], np.float64))).reshape(-1, len(PARAMETERS))
    cameras = {
        name: {"change": dict(zip(PARAMETERS, map(float, change), strict=True)),
               "sigma": dict(zip(PARAMETERS, map(float, sigma), strict=True))}
        for (name, change), sigma in zip(_read_changes(document).items(), sigmas, strict=True)
    }  # fmt: skip
    return {
        "number": one.number,
        "wall_ns": one.wall_ns,
        "moved": document["moved"],
        "cameras": cameras,
        "row_px": document["row_px"],
        "volume_percent": 100 * effect.share,
        "volume_sigma_percent": 100 * effect.sigma,
        "after_zero_percent": 100 * effect.share_after_zero,
        "after_zero_sigma_percent": 100 * effect.sigma_after_zero,
    }
