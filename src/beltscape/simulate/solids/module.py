"""The calibration module as solids: a base plate with cubes, spheres and cylinders."""

from __future__ import annotations

import numpy as np

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.geometry.shapes import Mesh, make_box, make_cylinder, make_sphere
from beltscape.simulate.geometry.world import Label, Solid
from beltscape.target.module import Cube, Cylinder, Feature, Module


def place_module(
    module: Module, x_mm: float = 0.0, y_mm: float = 0.0, turn_deg: float = 0.0, belt_mm: float = 0.0
) -> Pose:
    """Return world_from_module of a module on the level belt at height ``belt_mm``, rotated about z."""
    turn = Pose.of([0.0, 0.0, np.deg2rad(turn_deg)], np.zeros(3)).rotation
    return Pose(turn, np.array([x_mm, y_mm, belt_mm + module.base.size_mm[2]]))


def make_module_solids(
    module: Module, world_from_module: Pose, reflectance: float = 0.55
) -> tuple[Solid, ...]:
    """Return the base, then the features in the order of `Module.features`, labelled BASE, FEATURE, FEATURE + 1, ….

    Round shapes are meshes within 0.003 mm of the exact ones.
    """
    base = make_box(module.base.size_mm)
    below_origin = Pose(np.eye(3), np.array([0.0, 0.0, -module.base.size_mm[2]]))
    parts = [("base", int(Label.BASE), base.transform(below_origin))]
    parts += [
        (feature.name, Label.FEATURE + i, _make_feature_mesh(feature))
        for i, feature in enumerate(module.features)
    ]
    return tuple(
        Solid(
            name,
            label,
            world_from_module.apply(mesh.vertices_mm),
            mesh.faces,
            (reflectance, reflectance, reflectance),
        )
        for name, label, mesh in parts
    )


def _make_feature_mesh(feature: Feature) -> Mesh:
    """Return a feature's mesh at its position on the module's base."""
    lift = 0.0
    if isinstance(feature, Cube):
        mesh = make_box([feature.edge_mm] * 3)
    elif isinstance(feature, Cylinder):
        mesh = make_cylinder(feature.diameter_mm / 2, feature.height_mm)
    else:
        mesh, lift = make_sphere(feature.diameter_mm / 2), feature.diameter_mm / 2
    return mesh.transform(Pose(np.eye(3), np.array([*feature.center_mm, lift])))
