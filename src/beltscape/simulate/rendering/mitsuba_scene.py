"""Solids as Mitsuba shapes, and light as Mitsuba emitters.

Light on a diffuse surface is its colour times the incident light, so the two are rendered separately: the colours as
emission, which needs no light paths, and the light on white surfaces. Highlights of glossy surfaces are a third
appearance. Only for light between surfaces are all three combined in the "real" appearance.

The emitters are the diffuse ambient light of the hall and the projector. A white diffuse surface in the open yields
1 under ambient light of 1, and `Projector.power` at 1000 mm under a white pixel.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beltscape.core.errors import InputError
from beltscape.core.geometry.pose import Pose
from beltscape.simulate.world import Projector, Solid, World

Appearance = Literal["real", "emissive", "white", "highlights"]
_ROUGHNESS = 0.2
"""Mitsuba's alpha of the glossy share: satin, a highlight about 20° wide."""


def make_shapes(
    mi: Any, solids: Sequence[Solid], appearance: Appearance, *, texture_filter: str
) -> dict[str, Any]:
    """Return entries of a scene dictionary. Untextured solids of equal gloss become one mesh, coloured by face."""
    plain: dict[float, list[Solid]] = {}
    entries: dict[str, Any] = {}
    for index, solid in enumerate(solids):
        _check(solid)
        if solid.texture is not None and appearance in ("real", "emissive"):
            entries[f"textured_{index}"] = _make_textured_mesh(mi, solid, appearance, texture_filter)
        else:
            plain.setdefault(solid.gloss if appearance in ("real", "highlights") else 0.0, []).append(solid)
    for index, (gloss, group) in enumerate(plain.items()):
        entries[f"plain_{index}"] = _make_plain_mesh(mi, group, appearance, gloss)
    return entries


def _check(solid: Solid) -> None:
    if solid.texture is not None and (solid.uv is None or len(solid.uv) != len(solid.vertices_mm)):
        raise InputError(f"solid {solid.name}: has a texture; give uv for each of its vertices")
    if len(solid.faces) == 0:
        raise InputError(f"solid {solid.name}: has no faces; leave it out")
    if not np.isfinite(solid.vertices_mm).all():
        raise InputError(f"solid {solid.name}: a vertex is not finite")
    if solid.faces.min() < 0 or solid.faces.max() >= len(solid.vertices_mm):
        raise InputError(f"solid {solid.name}: a face refers to a vertex that does not exist")


def _make_plain_mesh(mi: Any, group: list[Solid], appearance: Appearance, gloss: float) -> Any:
    offsets = np.cumsum([0] + [len(solid.vertices_mm) for solid in group])
    vertices = np.concatenate([solid.vertices_mm for solid in group])
    faces = np.concatenate([solid.faces + at for solid, at in zip(group, offsets, strict=False)])
    colours = {"type": "mesh_attribute", "name": "face_color"}
    mesh = _make_mesh(mi, vertices, faces, _surface_parts(appearance, colours, gloss))
    if appearance in ("real", "emissive"):
        by_face = [np.tile(np.array(solid.reflectance, np.float32), (len(solid.faces), 1)) for solid in group]
        mesh.add_attribute("face_color", 3, np.concatenate(by_face).ravel())
    return mesh


def _make_textured_mesh(mi: Any, solid: Solid, appearance: Appearance, texture_filter: str) -> Any:
    assert solid.texture is not None
    assert solid.uv is not None
    colours = {
        "type": "bitmap",
        "data": mi.TensorXf(np.float32(solid.texture) * np.array(solid.reflectance, np.float32)),
        "raw": True,
        "filter_type": texture_filter,
        "wrap_mode": "clamp",
    }
    return _make_mesh(
        mi, solid.vertices_mm, solid.faces, _surface_parts(appearance, colours, solid.gloss), solid.uv
    )


def _surface_parts(appearance: Appearance, colours: dict[str, Any], gloss: float) -> dict[str, Any]:
    """Return the parts of a shape. Surfaces are two-sided (open meshes are lit from below too); emissive ones not."""
    if appearance == "emissive":
        return {"emitter": {"type": "area", "radiance": colours}}
    if appearance == "white":
        return {"surface": {"type": "twosided", "one": {"type": "diffuse", "reflectance": 1.0}}}
    matt: dict[str, Any] = {"type": "diffuse", "reflectance": colours if appearance == "real" else 0.0}
    if gloss == 0:
        return {"surface": {"type": "twosided", "one": matt}}
    shiny = {"type": "roughplastic", "diffuse_reflectance": matt["reflectance"], "alpha": _ROUGHNESS}
    mixed = {"type": "blendbsdf", "weight": float(gloss), "matt": matt, "shiny": shiny}
    return {"surface": {"type": "twosided", "one": mixed}}


def _make_mesh(
    mi: Any,
    vertices_mm: NDArray[np.float64],
    faces: NDArray[np.int64],
    parts: dict[str, Any],
    uv: NDArray[np.float64] | None = None,
) -> Any:
    properties = mi.Properties()
    for name, part in parts.items():
        properties[name] = mi.load_dict(part)
    mesh = mi.Mesh(
        "solid", len(vertices_mm), len(faces), props=properties, has_vertex_texcoords=uv is not None
    )
    buffers = mi.traverse(mesh)
    buffers["vertex_positions"] = np.float32(vertices_mm).ravel()
    buffers["faces"] = np.uint32(faces).ravel()
    if uv is not None:
        buffers["vertex_texcoords"] = np.float32(uv).ravel()
    buffers.update()
    return mesh


def make_emitters(mi: Any, world: World) -> dict[str, Any]:
    """Return entries of a scene dictionary."""
    entries: dict[str, Any] = {}
    if world.projector is not None:
        entries["projector"] = _make_projector(mi, world.projector)
    # Without sampling weight no ray is aimed at the ambient light, only reflected into it: there is no noise where
    # nothing occludes it, and all aimed rays sample the projector. As the only emitter it needs a weight.
    entries["hall"] = {
        "type": "constant",
        "radiance": float(world.ambient),
        "sampling_weight": 0.0 if entries else 1.0,
    }
    return entries


def device_to_world(mi: Any, device_from_world: Pose) -> Any:
    """Return Mitsuba's transform of a camera or projector: x points left, y up, z along the view."""
    matrix = np.eye(4)
    matrix[:3, :3] = device_from_world.rotation.T * [-1.0, -1.0, 1.0]
    matrix[:3, 3] = device_from_world.center_mm
    return mi.ScalarTransform4f(matrix)


def _make_projector(mi: Any, projector: Projector) -> dict[str, Any]:
    camera = projector.camera
    width, height = camera.size_px
    if np.any(camera.distortion):
        raise InputError(
            f"projector {camera.name}: its lens is assumed to be free of distortion; set it to zero"
        )
    if projector.pattern.shape != (height, width, 3):
        raise InputError(
            f"projector {camera.name}: the pattern's shape is {projector.pattern.shape}, not ({height}, {width}, 3)"
        )
    # a border of one black texel, because the nearest texel is repeated outside the frame
    texture = np.pad(np.float32(projector.pattern), ((1, 1), (1, 1), (0, 0)))
    half_width, to_uv = _symmetric_frustum(camera.focal_px, camera.center_px, (width + 2, height + 2))
    return {
        "type": "projector",
        "to_world": device_to_world(mi, projector.projector_from_world),
        "fov": float(np.rad2deg(2 * np.arctan(half_width))),
        "fov_axis": "x",
        # irradiance at 1 mm; Mitsuba multiplies by π, and a white surface reflects 1/π of it as radiance
        "scale": float(projector.power) * 1000.0**2,
        "irradiance": {
            "type": "bitmap",
            "data": mi.TensorXf(texture),
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "clamp",
            "to_uv": mi.ScalarTransform3f(to_uv),
        },
    }


def _symmetric_frustum(
    focal_px: NDArray[np.float64], center_px: NDArray[np.float64], size_px: tuple[int, int]
) -> tuple[float, NDArray[np.float64]]:
    """Return the half width x/z of Mitsuba's symmetric frustum, and (3, 3) its uv → uv of the bordered pattern."""
    size = np.array(size_px, dtype=np.float64)
    center = center_px + 1.5  # from the outer corner of the border
    reach = np.maximum(center, size - center) / focal_px
    half_width = max(reach[0], reach[1] * size[0] / size[1])
    half = np.array([half_width, half_width * size[1] / size[0]])
    to_uv = np.eye(3)
    to_uv[[0, 1], [0, 1]] = 2 * half * focal_px / size
    to_uv[:2, 2] = (center - half * focal_px) / size
    return float(half_width), to_uv
