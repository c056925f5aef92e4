"""Single rocks: broken, rough polyhedra of a given size, or pressed bodies with smooth faces.

Their sizes are drawn from size distributions of broken rock by mass.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, model_validator

from beltscape.core.geometry.pose import Pose
from beltscape.simulate.shapes import Mesh, subdivide

_WAVES = 12
"""Cosine waves whose sum is the roughness."""
_ROUND = 24
"""Corners of a pressed body's round outline: on 60 mm it deviates from a circle by 0.25 mm."""
_FINE_MM = 25.0
"""Size from which the faces of a rock are subdivided once more, so that the roughness keeps its grain."""


Form = Literal["ellipsoid", "cylinder", "cuboid"]


class ShapeSettings(BaseModel):
    """The shape of rocks."""

    model_config = ConfigDict(frozen=True, extra="forbid")
    longest: Annotated[float, Field(ge=1, le=4)] = 1.6
    """Maximum ratio of the longest to the middle axis."""
    flattest: Annotated[float, Field(gt=0.2, le=1)] = 0.6
    """Minimum ratio of the shortest to the middle axis."""
    roughness: Annotated[float, Field(ge=0, le=0.2)] = 0.05
    """Standard deviation of the surface from the flat faces, as a share of the radius."""
    corners: tuple[Annotated[int, Field(ge=6)], Annotated[int, Field(le=100)]] = (13, 25)
    """Least and greatest number of points of which a broken rock is the hull: few give large faces, sharp edges."""
    lean_deg: Annotated[float, Field(ge=0, le=90)] = 25.0
    """Standard deviation of a rock's inclination to its flat side."""
    pressed: Annotated[float, Field(ge=0, le=1)] = 0.0
    """Share of pressed bodies among the rocks: pellets, briquettes and blocks, all without roughness."""
    forms: Annotated[tuple[Form, ...], Field(min_length=1)] = ("ellipsoid", "cylinder", "cuboid")
    """Forms of the pressed bodies, all as frequent: ellipsoids with axes alike are pellets, long cylinders rods."""

    @model_validator(mode="after")
    def _check_order(self) -> ShapeSettings:
        least, greatest = self.corners
        if least > greatest:
            raise ValueError(f"corners = [{least}, {greatest}]: the first must not exceed the second")
        return self


@dataclass(frozen=True, slots=True, eq=False)
class Rock:
    """One rock about its centroid, in its final orientation."""

    mesh: Mesh
    size_mm: float
    """Extent along the middle principal axis, approximately the sieve size that the rock just passes."""


def make_rock(size_mm: float, settings: ShapeSettings, rng: np.random.Generator) -> Rock:
    """Return a rock: a broken one, or a pressed body by the settings' share."""
    pressed = settings.pressed > 0 and rng.random() < settings.pressed
    mesh = _make_pressed(settings, rng) if pressed else _make_broken(size_mm, settings, rng)
    upright = mesh.vertices_mm @ _principal_axes(mesh)  # x longest, z shortest
    scale = size_mm / float(np.ptp(upright[:, 1]))
    return Rock(
        Mesh(upright * scale, mesh.faces).transform(_draw_orientation(settings.lean_deg, rng)), size_mm
    )


def _make_broken(size_mm: float, settings: ShapeSettings, rng: np.random.Generator) -> Mesh:
    """Return the convex hull of random points on an ellipsoid, subdivided and roughened by smooth noise.

    Vertices move along their radius only, so that the mesh stays closed and does not intersect itself.
    """
    least, greatest = settings.corners
    points = rng.normal(size=(rng.integers(least, greatest + 1), 3))
    points /= np.linalg.norm(points, axis=1)[:, None]
    mesh = _make_hull(points * _draw_axes(settings, rng))
    for _ in range(2 if size_mm >= _FINE_MM else 1):
        mesh = subdivide(mesh)
    return _roughen(mesh, settings.roughness, rng)


def _make_pressed(settings: ShapeSettings, rng: np.random.Generator) -> Mesh:
    """Return an ellipsoid, a cylinder or a cuboid with axes of different lengths."""
    angle = 2 * np.pi * np.arange(_ROUND) / _ROUND
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    form = settings.forms[rng.integers(len(settings.forms))]
    if form == "ellipsoid":
        z = np.linspace(-1, 1, _ROUND // 2 + 1)[1:-1]
        rings = [np.column_stack([ring * np.sqrt(1 - at**2), np.full(_ROUND, at)]) for at in z]
        points = np.concatenate([*rings, [[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]]])
    elif form == "cylinder":
        points = np.concatenate([np.column_stack([np.full(_ROUND, at), ring]) for at in (-1.0, 1.0)])
    else:
        points = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(-1, 3)
    return _make_hull(points * _draw_axes(settings, rng))


def _draw_axes(settings: ShapeSettings, rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw (3,) the longest, the middle and the shortest half axis relative to the middle one."""
    return np.array([rng.uniform(1, settings.longest), 1.0, rng.uniform(settings.flattest, 1)])


def _make_hull(points: NDArray[np.float64]) -> Mesh:
    """Return the convex hull of points (N, 3) about its centroid."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(points)
    corners = points[hull.simplices]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inward = (normals * hull.equations[:, :3]).sum(axis=1) < 0
    faces = np.where(inward[:, None], hull.simplices[:, ::-1], hull.simplices).astype(np.int64)
    used, index = np.unique(faces, return_inverse=True)
    mesh = Mesh(points[used], index.reshape(faces.shape))
    return Mesh(mesh.vertices_mm - compute_centroid(mesh), mesh.faces)


def _roughen(mesh: Mesh, roughness: float, rng: np.random.Generator) -> Mesh:
    """Return the mesh with vertices moved along their radius by a sum of random waves, again about its centroid."""
    waves = rng.normal(size=(_WAVES, 3))
    waves *= (rng.uniform(3, 9, _WAVES) / np.linalg.norm(waves, axis=1))[:, None]
    phase = rng.uniform(0, 2 * np.pi, _WAVES)
    noise = np.cos(mesh.vertices_mm @ waves.T + phase).sum(axis=1) * np.sqrt(2 / _WAVES)
    factor = np.clip(1 + roughness * noise, 0.3, None)
    roughened = Mesh(mesh.vertices_mm * factor[:, None], mesh.faces)
    return Mesh(roughened.vertices_mm - compute_centroid(roughened), mesh.faces)


def compute_centroid(mesh: Mesh) -> NDArray[np.float64]:
    """Return (3,) the centroid of the volume of a closed mesh."""
    origin = mesh.vertices_mm.mean(axis=0)
    a, b, c = np.moveaxis((mesh.vertices_mm - origin)[mesh.faces], 1, 0)
    volumes = (a * np.cross(b, c)).sum(axis=1)
    return origin + (volumes[:, None] * (a + b + c) / 4).sum(axis=0) / volumes.sum()


def _principal_axes(mesh: Mesh) -> NDArray[np.float64]:
    """Return (3, 3) columns: axes of the volume's second moments, the longest extent first; a rotation."""
    a, b, c = np.moveaxis(mesh.vertices_mm[mesh.faces], 1, 0)
    volumes = (a * np.cross(b, c)).sum(axis=1)
    # ∫ x xᵀ over a tetrahedron with a corner at the origin: V/20·(Σ p pᵀ + s sᵀ), s the sum of its corners
    sums = sum(np.einsum("f,fi,fj->ij", volumes, p, p) for p in (a, b, c, a + b + c))
    _, axes = np.linalg.eigh(sums)
    axes = axes[:, ::-1] * np.sign(axes[np.abs(axes).argmax(axis=0), range(3)])[::-1]
    return axes if np.linalg.det(axes) > 0 else axes * [1, 1, -1]


def _draw_orientation(lean_deg: float, rng: np.random.Generator) -> Pose:
    """Draw an orientation: flat side down or up, slightly inclined, any angle about the vertical."""
    yaw, azimuth = rng.uniform(0, 2 * np.pi, 2)
    angle = np.deg2rad(lean_deg) * rng.normal()
    inclination = Pose.of(angle * np.array([np.cos(azimuth), np.sin(azimuth), 0.0]), np.zeros(3))
    flip = Pose.of([np.pi if rng.random() < 0.5 else 0.0, 0.0, 0.0], np.zeros(3))
    return inclination @ flip @ Pose.of([0.0, 0.0, yaw], np.zeros(3))


Millimetres = Annotated[float, Field(gt=0, le=1e4, allow_inf_nan=False)]
_STEPS = 4000
"""Steps of the integration over the sizes."""


class SizeSettings(BaseModel):
    """The share of the mass that passes a sieve of width d, truncated at both ends.

    Rosin–Rammler: 1 − exp(−ln 2·(d/median)ⁿ); Gaudin–Schuhmann: (d/largest)ⁿ.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")
    law: Literal["rosin-rammler", "gaudin-schuhmann"] = "rosin-rammler"
    smallest_mm: Millimetres = 10.0
    largest_mm: Millimetres = 79.0
    median_mm: Millimetres = 50.0
    """Median by mass of the untruncated Rosin–Rammler law."""
    exponent: Annotated[float, Field(gt=0, le=20)] = 2.5
    """Uniformity of the distribution: a larger exponent makes it narrower."""

    @model_validator(mode="after")
    def _check_order(self) -> SizeSettings:
        if self.smallest_mm >= self.largest_mm:
            raise ValueError(
                f"smallest_mm = {self.smallest_mm:g} must be below largest_mm = {self.largest_mm:g}"
            )
        return self

    def share_passing(self, size_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the mass share of rocks up to sizes (N,); 0 at the smallest size, 1 at the largest."""
        ends = self._untruncated(np.array([self.smallest_mm, self.largest_mm]))
        inside = np.clip(size_mm, self.smallest_mm, self.largest_mm)
        return (self._untruncated(inside) - ends[0]) / (ends[1] - ends[0])

    def _untruncated(self, size_mm: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.law == "gaudin-schuhmann":
            return (size_mm / self.largest_mm) ** self.exponent
        return 1 - np.exp(-np.log(2) * (size_mm / self.median_mm) ** self.exponent)


def draw_sizes(settings: SizeSettings, count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return (count,) sizes in mm whose mass (∝ d³) follows the law, in random order.

    One size is drawn from each of ``count`` equal shares of the number distribution, so that few rocks follow it too.
    """
    edges = np.geomspace(settings.smallest_mm, settings.largest_mm, _STEPS + 1)
    middles = np.sqrt(edges[1:] * edges[:-1])
    number = np.cumsum(np.diff(settings.share_passing(edges)) / middles**3)  # number of rocks: mass over d³
    share = np.concatenate([[0.0], number / number[-1]])
    quantiles = (np.arange(count) + rng.random(count)) / max(count, 1)
    return rng.permutation(np.interp(quantiles, share, edges))
