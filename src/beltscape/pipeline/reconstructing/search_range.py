"""The depth range of a capture: found from its images, or given and checked against the rig and the images."""

from __future__ import annotations

from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from beltscape.core.errors import ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Reporter, Silent
from beltscape.core.quantities import UNITS
from beltscape.core.system_calls import count_usable_cores
from beltscape.files.rig_limits import LEAST_DEPTH_MM
from beltscape.sources.folder import FolderSource
from beltscape.stereo.consistency.check import check_consistency
from beltscape.stereo.consistency.diagnosis import diagnose_cameras, diagnose_low_coverage
from beltscape.stereo.multiview.depth_range import compute_search_range, find_depth_range

RANGE_FRAMES = 5
"""Number of frames of a sequence in which the depth range is searched."""
_BEYOND = 10.0
"""Factor by which a range may be nearer than the nearest surface that the rig's poses suggest; beyond it, more
than 4096 planes would have to be searched and no two cameras share a view."""
_MISSED = 0.25
"""Share of the range found in the images that may lie outside the given one before it is a warning."""


def require_depth_range(given_mm: tuple[float, float], rig: Rig, auxiliaries: tuple[str, ...]) -> None:
    """Raise SettingsError if a given depth range (near, far) cannot be in millimetres, or is too wide."""
    (near, far), (low, high) = given_mm, compute_search_range(rig, auxiliaries)
    given = f"depth range {near:g} to {far:g} mm"
    where = f"the cameras of this rig meet between {low:.0f} and {high:.0f} mm"
    if _is_disjoint(given_mm, (low, high)):
        for unit, factor in UNITS["mm"]:
            if near * factor < high and far * factor > low:
                raise SettingsError(
                    f"{given}: {where}; depths are in millimetres: were these {unit}? "
                    f"then give {near * factor:g} {far * factor:g}"
                )
    if far < low / _BEYOND:
        raise SettingsError(f"{given}: {where}; give a range there")
    if near < low / _BEYOND:
        raise SettingsError(
            f"{given}: is too wide to be searched, {where}; give a near end of at least {low / _BEYOND:.0f} mm"
        )


def check_depth_range(
    given_mm: tuple[float, float] | None, source: FolderSource, rig: Rig, reporter: Reporter
) -> None:
    """Check a given depth range (near, far) against the rig; warn if the first frame's images contradict it.

    Raises
    ------
    SettingsError
        When the range cannot be meant for this rig.
    """
    if given_mm is None:
        return
    require_depth_range(given_mm, rig, tuple(name for name in rig.auxiliaries if name in source.cameras))
    found = _find_range(source, rig)
    if found is None:
        return
    (near, far), (low, high) = given_mm, found
    if _is_disjoint(given_mm, found) and _is_disjoint(given_mm, compute_search_range(rig, rig.auxiliaries)):
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


def find_capture_depth_range(source: FolderSource, rig: Rig, reporter: Reporter) -> tuple[float, float]:
    """Return the near and far depth (mm) of the surfaces in a few frames spread over the capture."""
    chosen = {
        source.frames[int(i)] for i in np.unique(np.linspace(0, len(source) - 1, RANGE_FRAMES).astype(int))
    }
    ranges, failures = _search_frames(source, rig, chosen, reporter)
    if not ranges:
        _raise_diagnosis(source, rig, min(chosen))
        raise failures[-1] if failures else ReconstructionError(f"{source.folder}: no frame in it")
    near, far = min(near for near, _ in ranges), max(far for _, far in ranges)
    if far < LEAST_DEPTH_MM:
        raise ReconstructionError(
            f"{source.folder}: surfaces found {near:.3g} to {far:.3g} mm before {rig.core}; the rig seems to be in "
            "metres: multiply its translations by 1000"
        )
    return near, far


def _search_frames(
    source: FolderSource, rig: Rig, chosen: Collection[str], reporter: Reporter
) -> tuple[list[tuple[float, float]], list[ReconstructionError]]:
    """Return the depth ranges of the chosen frames, and why others show none; frames are searched side by side."""
    cores = count_usable_cores()
    threads = max(1, cores // len(chosen))

    def search(frame_set: FrameSet) -> tuple[float, float] | ReconstructionError:
        try:
            return find_depth_range(rig, frame_set, Silent(), threads)
        except ReconstructionError as error:
            return error

    ranges: list[tuple[float, float]] = []
    failures: list[ReconstructionError] = []
    with ThreadPoolExecutor(cores) as pool:
        for outcome in pool.map(search, source.preview_frames(chosen)):
            if isinstance(outcome, ReconstructionError):
                failures.append(outcome)
            else:
                ranges.append(outcome)
            reporter.step("looking for the surface", len(ranges) + len(failures), len(chosen))
    return ranges, failures


def _raise_diagnosis(source: FolderSource, rig: Rig, frame: str) -> None:
    """Raise a ReconstructionError with the most likely reason why a frame shows no surface."""
    for frame_set in source.select_frames({frame}):
        if rig.core in frame_set.images and len(frame_set.images) > 1:
            raise ReconstructionError(_diagnose_missing_surface(frame_set, rig))


def _diagnose_missing_surface(frame_set: FrameSet, rig: Rig) -> str:
    """Return the most likely reason why a frame shows no surface."""
    consistency = check_consistency(frame_set, rig, None)
    names = tuple(each.camera for each in consistency.cameras)
    faults = diagnose_cameras(frame_set, rig, consistency)
    if faults:
        return f"frame {frame_set.frame}: {'; '.join(fault.text for fault in faults)}"
    return diagnose_low_coverage(frame_set, rig, consistency, compute_search_range(rig, names), 0.0)[0]


def _is_disjoint(one_mm: tuple[float, float], other_mm: tuple[float, float]) -> bool:
    return one_mm[1] < other_mm[0] or one_mm[0] > other_mm[1]


def _find_range(source: FolderSource, rig: Rig) -> tuple[float, float] | None:
    """Return the depth range of the first frame; None if it shows no surface."""
    for frame_set in source.preview_frames(set(source.frames[:1])):
        try:
            return find_depth_range(rig, frame_set, Silent())
        except ReconstructionError:
            return None
    return None
