"""Reflectance at points of plain and textured solids."""

from __future__ import annotations

import numpy as np

from beltscape.simulate.ray_casting import RayScene, reflectance_at
from beltscape.simulate.world import Label, Solid

CORNERS = np.array([[0.0, 0, 0], [8, 0, 0], [8, 4, 0], [0, 4, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def test_texel_at_a_point_is_the_one_at_its_uv():
    texture = (np.arange(32).reshape(4, 8, 1).repeat(3, axis=2) / 32).astype(np.float32)
    textured = Solid(
        "sheet", Label.MATERIAL, CORNERS, FACES, (0.5, 0.5, 0.5), texture, CORNERS[:, :2] / [8, 4]
    )
    plain = Solid("plain", Label.BELT, CORNERS - [0, 0, 9], FACES, (0.1, 0.2, 0.3))
    solids = [plain, textured]
    x, y = np.meshgrid(np.linspace(0.5, 7.5, 8), np.linspace(0.5, 3.5, 4))
    above = np.column_stack([x.ravel(), y.ravel(), np.full(32, 5.0)])
    scene = RayScene(solids)
    hits = scene.cast(above, np.broadcast_to([0.0, 0, -1], above.shape))
    points = above + hits.distance[:, None] * [0, 0, -1.0]
    np.testing.assert_allclose(
        reflectance_at(scene, solids, hits.face, points), np.arange(32) / 64, atol=1e-6
    )
    below = above - [0, 0, 10]
    hits = scene.cast(below, np.broadcast_to([0.0, 0, -1], above.shape))
    np.testing.assert_allclose(reflectance_at(scene, solids, hits.face, below), 0.2)
    assert not reflectance_at(scene, solids, np.full(3, -1), np.zeros((3, 3))).any()
