"""Quantities of one frame: the empty belt, volume, lumps and the calibration module's dimensions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TypedDict, TypeVar, Unpack

from pydantic import BaseModel, ValidationError

from beltscape.core.arguments import require_image
from beltscape.core.checks import describe_kind, is_list_or_tuple, require_instance, require_pair
from beltscape.core.depth import DepthMap
from beltscape.core.empty_belt import Belt
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.frames import Image, to_grey
from beltscape.core.geometry.rig import Rig, pinhole_scale
from beltscape.files.paths import AnyPath, as_path
from beltscape.files.toml_text import describe_first_error, validate_strictly
from beltscape.measure.belt import empty_belt
from beltscape.measure.belt.settings import GivenBelt
from beltscape.measure.features.measure import measure_module
from beltscape.measure.features.result import MeasuredModule
from beltscape.measure.lumps import lumps as lumps_of_frame
from beltscape.measure.lumps.lumps import Lumps
from beltscape.measure.lumps.settings import LumpSettings
from beltscape.measure.volume import volume as volume_of_frame
from beltscape.measure.volume.settings import VolumeSettings
from beltscape.measure.volume.volume import Volume
from beltscape.stereo.pointcloud import undistort_image
from beltscape.target.module import Module, read_module

Range = tuple[float, float]
Settings = TypeVar("Settings", bound=BaseModel)


class VolumeOptions(TypedDict, total=False):
    """Further settings of `measure_volume`, which `VolumeSettings` describes."""

    cell_mm: float | None
    profile_every_mm: float
    surcharge_deg: float


class LumpOptions(TypedDict, total=False):
    """Settings of `measure_lumps`, which `LumpSettings` describes."""

    oversize_mm: float | None
    sieves_mm: Sequence[float]
    smallest_px: float
    raster_pixels: int
    split: float


def learn_belt(
    depths: Sequence[DepthMap],
    rig: Rig,
    *,
    width_mm: float | None = None,
    across_mm: Range | None = None,
    region_px: Sequence[Range] | None = None,
    travel_deg: float | None = None,
) -> Belt:
    """Return the model of the empty belt from one or more of its depth maps.

    >>> belt = bs.learn_belt([empty], rig)

    Parameters
    ----------
    depths
        Depth maps of the empty belt.
    rig
        The calibrated rig.
    width_mm
        Width of the belt along its surface, for ends that are not seen; None: not given.
    across_mm
        The belt's ends in x of the belt frame; None: found.
    region_px
        Corners u, v of a polygon in the depth map that contains the belt; None: the surface under the optical axis.
    travel_deg
        Direction of travel of a flat belt without edges in view: its angle to the core image's columns, clockwise.

    Returns
    -------
    The belt: ``across_mm``, what is known of its ``ends``, and more.

    Raises
    ------
    InputError, SettingsError
        if there is no depth map, one does not fit the rig, or an argument is wrong.
    MeasureError
        if there is no belt-like surface under the optical axis, or what is given contradicts it.
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    if isinstance(depths, DepthMap):
        raise InputError("depths is one DepthMap: give a list, [depth]")
    if not is_list_or_tuple(depths):
        raise InputError(f"depths is {describe_kind(depths)}: must be a list of DepthMap")
    given = _make_settings(
        GivenBelt,
        {
            "width_mm": width_mm, "across_mm": across_mm, "region_px": region_px, "travel_deg": travel_deg,
        },
    )  # fmt: skip
    return empty_belt.learn_belt(depths, rig.core_camera, given)


def measure_volume(
    depth: DepthMap,
    belt: Belt,
    rig: Rig,
    across_mm: Range | None = None,
    along_mm: Range | None = None,
    **settings: Unpack[VolumeOptions],
) -> Volume:
    """Measure the volume between the load and the empty belt in a box of the belt frame.

    >>> volume = bs.measure_volume(depth, belt, rig, along_mm=(-200, 200))
    >>> round(volume.volume_mm3 * 1e-6)
    13

    Parameters
    ----------
    depth
        Depth map of the load.
    belt
        The empty belt, learned with the same rig.
    rig
        The calibrated rig.
    across_mm, along_mm
        Ends of the box in x and y of the belt frame; None: the belt's measured width, and the well measured stretch.
    settings
        Further settings by name, those of `VolumeSettings`.

    Returns
    -------
    The volume: ``volume_mm3``, ``sigma_mm3``, ``height_map`` and more.

    Raises
    ------
    InputError, SettingsError
        with the argument that does not fit.
    MeasureError
        if nothing was measured in the box.
    """
    require_belt_of(belt, rig)
    for value, name in ((across_mm, "across_mm"), (along_mm, "along_mm")):
        if value is not None:
            require_pair(value, name)
    return volume_of_frame.measure_volume(
        depth,
        belt,
        rig.core_camera,
        _make_settings(VolumeSettings, settings),
        across_mm=across_mm,
        along_mm=along_mm,
        scale_sigma=rig.scale_sigma,
    )


def measure_lumps(
    depth: DepthMap, rig: Rig, belt: Belt | None = None, **settings: Unpack[LumpOptions]
) -> Lumps:
    """Segment the lumps of a depth map and measure their sizes.

    >>> lumps = bs.measure_lumps(depth, rig, belt=belt, oversize_mm=60)

    Without the empty ``belt``, positions are in the core camera's frame and fines are unknown. ``settings`` are those
    of `LumpSettings`, such as ``oversize_mm=150``.

    Raises
    ------
    InputError, SettingsError
        with the argument that does not fit.
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    if belt is not None:
        require_belt_of(belt, rig)
    return lumps_of_frame.measure_lumps(depth, rig.core_camera, _make_settings(LumpSettings, settings), belt)


def measure_features(
    depth: DepthMap,
    rig: Rig,
    module: Module | AnyPath,
    *,
    image: Image | None = None,
    plain: Image | None = None,
) -> MeasuredModule:
    """Measure the dimensions of the calibration module in a depth map.

    >>> features = bs.measure_features(depth_module, rig, demo / "module.toml", image=image_module)

    Parameters
    ----------
    depth
        Depth map of the module.
    rig
        The calibrated rig.
    module
        The module, or the path of its module.toml.
    image
        The core camera's image of the frame as recorded; edges and spheres need it.
    plain
        The core camera's image of the same still scene with the projector off; edges are clearer in it.

    Raises
    ------
    InputError
        with the argument that does not fit.
    MeasureError
        if the module is not found.
    """
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    for picture, name in ((image, "image"), (plain, "plain")):
        if picture is not None:
            require_image(picture, name)
    nominal = module if isinstance(module, Module) else read_module(as_path(module, "module"))
    pattern, unlit = (
        None if one is None else to_grey(undistort_image(one, rig.core_camera)) for one in (image, plain)
    )
    return measure_module(depth, rig, nominal, pattern=pattern, plain=unlit)


def require_belt_of(belt: Belt, rig: Rig) -> None:
    """Raise InputError unless the empty belt was learned with the rig's core camera."""
    require_instance(rig, Rig, "rig", "bs.read_rig(path)")
    require_instance(belt, Belt, "belt", "bs.learn_belt(depths, rig)")
    if not belt.belt_from_core.center_mm[2] > 0:  # origin of the belt frame, in the core's
        raise InputError("belt does not lie before the core camera: learn it with bs.learn_belt(depths, rig)")
    own = belt.camera  # images of the belt may have had another size
    if own is not None and (own.name != rig.core or pinhole_scale(own, rig.core_camera) is None):
        raise InputError(
            f"belt was learned with the core camera {own.name} of another rig: learn it with this rig's depth maps"
        )


def _make_settings(kind: type[Settings], values: Mapping[str, object]) -> Settings:
    try:
        return validate_strictly(kind, values, lambda key, value, oddity: f"{key} = {value:g}: {oddity}")
    except ValidationError as error:
        raise SettingsError(describe_first_error(kind, error)) from error
