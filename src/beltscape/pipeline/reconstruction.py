"""Capture and rig → depth maps, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from beltscape.core.depth import DepthMap
from beltscape.core.errors import InputError, ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Reporter
from beltscape.core.rig import Rig
from beltscape.files.atomic import output_folder
from beltscape.files.capture import read_capture
from beltscape.files.reconstruction import write_frame
from beltscape.files.rig_json import write_rig
from beltscape.pipeline.regions import write_regions
from beltscape.report.depth_picture import frame_picture
from beltscape.sources.folder import FolderSource
from beltscape.stereo.cloud import CloudBuilder
from beltscape.stereo.multiview import MultiviewReconstructor
from beltscape.stereo.multiview_settings import PRESETS, MultiviewSettings
from beltscape.stereo.pairs.pairwise import PairwiseReconstructor, horizontal_auxiliary
from beltscape.stereo.pairs.settings import PairwiseSettings
from beltscape.stereo.search import find_depth_range

METHODS = ("multiview", "pairwise", "binocular")
"""What `reconstruct` can do: all auxiliaries at once, or the paper's methods."""
SPARSE = 0.3
"""A frame of which less was measured is worth a word."""
LOOKS = 5
"""Frames of a sequence in which the depth range is looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One reconstructed frame."""

    frame_set: FrameSet
    depth: DepthMap


@dataclass(frozen=True, slots=True, eq=False)
class Reconstruction:
    """What was written."""

    auxiliaries: tuple[str, ...]
    depth_range_mm: tuple[float, float]
    frames: tuple[Mapping[str, Any], ...]
    """Per frame: plain values for JSON."""
    regions: Path | None
    """The check picture of the projected markers and their regions; None where none were seen."""


def reconstruct_capture(
    capture: Path,
    rig: Rig,
    out: Path,
    reporter: Reporter,
    *,
    method: str = "multiview",
    pair: str | None = None,
    preset: str = "standard",
    depth_range_mm: tuple[float, float] | None = None,
) -> Reconstruction:
    """Reconstruct every frame of a capture into ``out``: rig.json and a folder per frame.

    The markers of the first frame that can be measured, where it shows any, are drawn in regions.png.

    Raises
    ------
    InputError, SettingsError, ReconstructionError, OutputError
        With one line that names what is wrong and the mend.
    """
    wanted = auxiliaries_for(method, rig, pair)
    if preset not in PRESETS:
        raise SettingsError(f"preset {preset}: unknown; use --preset {', '.join(PRESETS)}")
    source = open_capture(capture, rig, reporter)
    auxiliaries = tuple(name for name in wanted if name in source.cameras)
    if not auxiliaries:
        raise InputError(
            f"{capture}: no images of {', '.join(wanted)}; --method binocular needs them (see --pair)"
        )
    output_folder(out)
    near_far = depth_range_mm or depth_range(source, rig, reporter)
    write_rig(out / "rig.json", rig)
    matcher = _matcher(method, preset, rig, near_far, auxiliaries)
    documents: list[Mapping[str, Any]] = []
    regions: Path | None = None
    builder = CloudBuilder(rig.core_camera)
    for frame in reconstruct(source, matcher, reporter):
        if not documents:
            regions = write_regions(out / "regions.png", frame.frame_set, rig, (rig.core, *auxiliaries))
        documents.append(_write(out / frame.frame_set.frame, frame, builder))
        reporter.step("reconstructing", len(documents), len(source))
    return Reconstruction(auxiliaries, near_far, tuple(documents), regions)


def _write(folder: Path, frame: Frame, builder: CloudBuilder) -> Mapping[str, Any]:
    depth, image = frame.depth, frame.frame_set.images[builder.camera.name]
    write_frame(folder, depth, builder.cloud(depth, image), frame_picture(depth), builder.undistorted(image))
    measured = depth.measured.any()
    return {
        "frame": frame.frame_set.frame,
        "folder": folder,
        "coverage": depth.coverage,
        "median_depth_mm": float(np.nanmedian(depth.depth_mm)) if measured else float("nan"),
        "median_sigma_mm": float(np.nanmedian(depth.sigma_mm)) if measured else float("nan"),
    }


def open_capture(folder: Path, rig: Rig, reporter: Reporter) -> FolderSource:
    """The frames of a capture as the rig's cameras saw them.

    Raises
    ------
    InputError
        When the capture has no images of the core camera, or of no other camera of the rig.
    """
    capture = read_capture(folder)
    if rig.core not in capture.cameras:
        raise InputError(
            f"{folder / rig.core}: no images of the core camera {rig.core}; the capture has "
            f"{', '.join(capture.cameras)}"
        )
    if not set(capture.cameras) & set(rig.auxiliaries):
        raise InputError(
            f"{folder}: no images of an auxiliary camera of the rig ({', '.join(rig.auxiliaries)}); "
            "depth needs a second view"
        )
    return FolderSource(capture, {name: camera.size_px for name, camera in rig.cameras.items()}, reporter)


def auxiliaries_for(method: str, rig: Rig, pair: str | None) -> tuple[str, ...]:
    """Which auxiliary cameras a method uses.

    Raises
    ------
    SettingsError
        When there is no such method, or no such camera.
    """
    if method not in METHODS:
        raise SettingsError(f"method {method}: unknown; use --method {', '.join(METHODS)}")
    if pair is not None and (method != "binocular" or pair not in rig.auxiliaries):
        raise SettingsError(
            f"pair {pair}: --method binocular pairs {rig.core} with one of {', '.join(rig.auxiliaries)}"
        )
    return (pair or horizontal_auxiliary(rig),) if method == "binocular" else rig.auxiliaries


def depth_range(source: FolderSource, rig: Rig, reporter: Reporter) -> tuple[float, float]:
    """Near and far end (mm) of what a few frames, spread over the capture, show."""
    chosen = {source.frames[i] for i in np.unique(np.linspace(0, len(source) - 1, LOOKS).astype(int))}
    ranges: list[tuple[float, float]] = []
    failure: ReconstructionError | None = None
    for frame_set in source.only(chosen):
        try:
            ranges.append(find_depth_range(rig, frame_set, reporter))
        except ReconstructionError as error:
            failure = error
    if not ranges:
        raise failure or ReconstructionError(f"{source.folder}: no frame in it")
    return min(near for near, _ in ranges), max(far for _, far in ranges)


class Matcher(Protocol):
    """What makes depth of one frame."""

    def reconstruct(self, frame_set: FrameSet, reporter: Reporter) -> DepthMap:
        """Depth of one frame, or ReconstructionError where its images do not suffice."""
        ...


def _matcher(
    method: str, preset: str, rig: Rig, near_far: tuple[float, float], auxiliaries: tuple[str, ...]
) -> Matcher:
    if method != "multiview":
        return PairwiseReconstructor(rig, near_far, PairwiseSettings(), auxiliaries=auxiliaries)
    return MultiviewReconstructor(rig, near_far, MultiviewSettings.preset(preset), auxiliaries=auxiliaries)


def reconstruct(source: FolderSource, matcher: Matcher, reporter: Reporter) -> Iterator[Frame]:
    """Depth of every frame that can be measured; the others are named.

    Raises
    ------
    ReconstructionError
        When not a single frame can be measured.
    """
    done, failure = 0, None
    for frame_set in source:
        try:
            depth = matcher.reconstruct(frame_set, reporter)
        except ReconstructionError as error:
            failure = error
            reporter.warn(f"{error}; going on without this frame")
            continue
        done += 1
        if depth.coverage < SPARSE:
            reporter.warn(
                f"frame {frame_set.frame}: only {depth.coverage:.0%} of the pixels are measured; "
                "is the speckle projector on, and the exposure long enough?"
            )
        yield Frame(frame_set, depth)
    if not done:
        raise failure or ReconstructionError(f"{source.folder}: no frame in it")
