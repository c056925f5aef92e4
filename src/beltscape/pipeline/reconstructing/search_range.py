"""A depth range that is given, held against the rig and the images."""

from __future__ import annotations

from beltscape.core.errors import ReconstructionError, SettingsError
from beltscape.core.progress import Reporter, Silent
from beltscape.core.rig import Rig
from beltscape.sources.folder import FolderSource
from beltscape.stereo.multiview.initialisation.depth_range import find_depth_range, search_range

_UNITS = {1000.0: "metres", 10.0: "centimetres", 0.001: "micrometres"}
"""Millimetres in a unit that a range may have been given in by mistake → its name."""
_BEYOND = 10.0
"""A range may be so many times nearer than the nearest surface that the rig's poses suggest; nearer, planes are
too many to be searched (4096) and no two cameras share a view."""
_MISSED = 0.25
"""Share of the range found in the images that may lie outside the given one before it is a warning."""


def require_depth_range(given_mm: tuple[float, float], rig: Rig, auxiliaries: tuple[str, ...]) -> None:
    """Raise SettingsError where a given depth range (near, far) cannot be meant in millimetres, or is too wide."""
    (near, far), (low, high) = given_mm, search_range(rig, auxiliaries)
    told = f"depth range {near:g} to {far:g} mm"
    where = f"the cameras of this rig meet between {low:.0f} and {high:.0f} mm"
    if _misses(given_mm, (low, high)):
        for factor, unit in _UNITS.items():
            if near * factor < high and far * factor > low:
                raise SettingsError(
                    f"{told}: {where}; depths are in millimetres: were these {unit}? "
                    f"then give {near * factor:g} {far * factor:g}"
                )
    if far < low / _BEYOND:
        raise SettingsError(f"{told}: {where}; give a range there")
    if near < low / _BEYOND:
        raise SettingsError(
            f"{told}: is too wide to be searched, {where}; give a near end of at least {low / _BEYOND:.0f} mm"
        )


def check_depth_range(
    given_mm: tuple[float, float] | None, source: FolderSource, rig: Rig, reporter: Reporter
) -> None:
    """Hold a given depth range (near, far) against the rig, and warn where the first frame's images contradict it.

    Raises
    ------
    SettingsError
        When the range cannot be meant for this rig.
    """
    if given_mm is None:
        return
    require_depth_range(given_mm, rig, tuple(name for name in rig.auxiliaries if name in source.cameras))
    found = _found(source, rig)
    if found is None:
        return
    (near, far), (low, high) = given_mm, found
    if _misses(given_mm, found) and _misses(given_mm, search_range(rig, rig.auxiliaries)):
        raise SettingsError(
            f"depth range {near:g} to {far:g} mm: neither do the cameras of this rig meet there, nor do the images "
            f"show a surface, which lies between {low:.0f} and {high:.0f} mm; give a range about that, or none"
        )
    margin = _MISSED * (high - low)
    if near > low + margin or far < high - margin:
        reporter.warn(
            f"depth range {near:g} to {far:g} mm: the images show surfaces from {low:.0f} to {high:.0f} mm; "
            "what lies outside the given range is matched wrongly or not at all"
        )


def _misses(one_mm: tuple[float, float], other_mm: tuple[float, float]) -> bool:
    return one_mm[1] < other_mm[0] or one_mm[0] > other_mm[1]


def _found(source: FolderSource, rig: Rig) -> tuple[float, float] | None:
    """What the first frame shows; None where nothing stands out in it."""
    for frame_set in source.select_frames(set(source.frames[:1])):
        try:
            return find_depth_range(rig, frame_set, Silent())
        except ReconstructionError:
            return None
    return None
