"""A capture's files as a recording: frames with times and positions as a replay gives them, and their digest."""

from __future__ import annotations

import re
from calendar import timegm
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from time import strptime

from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.capture import FolderContent, describe_left_out, describe_missing_frames, index_images
from beltscape.files.encoder_csv import parse_encoder
from beltscape.files.exposures_csv import FILE as EXPOSURES
from beltscape.files.exposures_csv import parse_exposures
from beltscape.files.frame_names import match_frames, sort_frames
from beltscape.files.paths import decode_text
from beltscape.pipeline.measuring.instants import Instant, drop_positions, pair_readings, time_frames
from beltscape.reprocessing.recordings.recording import Place, RecordedFrame, Recording
from beltscape.reprocessing.recordings.tree import FileEntry, Folder, Tree
from beltscape.sources.folder import describe_lost_camera

ENCODER = "encoder.csv"
_STAMP = re.compile(r"(?:.*/)?\d+-(\d{8}T\d{6}Z)(?:[-.].*)?")
"""Name that the recorder gives a capture: number, wall clock, reason (`CaptureStore.new_path`)."""
_NO_EXPOSURES: Mapping[str, float] = {}


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """Options by which a source's captures are read."""

    cameras: Mapping[str, tuple[int, int]]
    """Camera of the rig → (width, height) in px, in the rig's order."""
    core: str
    with_positions: bool
    """Whether the belt's positions come from encoder.csv."""
    frames_per_s: float | None


@dataclass(frozen=True, slots=True)
class CaptureListing:
    """Listed files of a capture."""

    tree: Tree
    path: str
    name: str
    folder: Folder
    cameras: Mapping[str, Folder]
    """The rig's cameras that have a folder."""


def make_recording(listing: CaptureListing, options: CaptureOptions, reporter: Reporter) -> Recording:
    """Return the recording of a capture; problems that a replay survives are warnings, as they are there.

    Raises
    ------
    InputError
        When its tables cannot be read, its frames have no times, or there are no images of a second camera.
    """
    place = listing.tree.place(listing.path)
    images = _index_cameras(listing, options, place, reporter)
    frames = sort_frames(images.values())
    instants = _list_instants(listing, options, frames, place, reporter)
    exposures = _read_exposures(listing.folder, place)
    return Recording(
        listing.name,
        place,
        tuple(_make_frame(instant, images, exposures) for instant in instants),
        find_wall_clock(listing.name),
        _compute_digest(listing, images),
    )


def find_wall_clock(name: str) -> int | None:
    """Return the wall clock in a capture's name, ns since 1970 UTC; None if it has none."""
    match = _STAMP.fullmatch(name)
    if match is None:
        return None
    try:
        return timegm(strptime(match[1], "%Y%m%dT%H%M%SZ")) * 10**9
    except ValueError:
        return None


def _index_cameras(
    listing: CaptureListing, options: CaptureOptions, place: Place, reporter: Reporter
) -> dict[str, Mapping[str, FileEntry]]:
    """Return camera → frame → file, of those cameras of the rig that have images."""
    images: dict[str, dict[str, FileEntry]] = {}
    for camera in options.cameras:
        listed, own = listing.cameras.get(camera), place.describe_folder(camera)
        files = listed.files if listed else {}
        names = index_images(files, own)
        if listed and (line := _describe_left_out(own, listed)):
            reporter.warn(line)
        if names:
            images[camera] = {frame: files[name] for frame, name in names.items()}
        else:
            reporter.warn(describe_lost_camera(place.address, camera))
    others = [camera for camera in options.cameras if camera != options.core]
    if not set(images) & set(others):
        raise InputError(
            f"{place.address}: no images of an auxiliary camera of the rig ({', '.join(others)}); "
            "depth needs a second view"
        )
    matched, lines = match_frames(images, place.address)
    missing = describe_missing_frames({place.describe_folder(name): own for name, own in matched.items()})
    for line in (*lines.values(), *missing):
        reporter.warn(line)
    return matched


def _describe_left_out(name: str, folder: Folder) -> str:
    files, folders, others = (tuple(sorted(names)) for names in (folder.files, folder.folders, folder.others))
    return describe_left_out(name, FolderContent(files, folders, others))


def _list_instants(
    listing: CaptureListing,
    options: CaptureOptions,
    frames: Sequence[str],
    place: Place,
    reporter: Reporter,
) -> list[Instant]:
    """Return the instants as `pipeline.measuring.instants.list_instants` does for a folder."""
    table, has_table = place.describe_folder(ENCODER), ENCODER in listing.folder.files
    if not has_table and (options.with_positions or options.frames_per_s is None):
        fix = "" if options.with_positions else ", or give frames_per_s in [capture]"
        raise InputError(f"{table}: no such file; the times of the frames are needed: add it{fix}")
    if options.frames_per_s is not None and not options.with_positions:
        return time_frames(frames, options.frames_per_s)
    readings = parse_encoder(_read_text(listing.folder, ENCODER, place), table)
    instants = pair_readings(readings, frames, table, place.address, reporter)
    return instants if options.with_positions else drop_positions(instants)


def _read_exposures(folder: Folder, place: Place) -> Mapping[str, Mapping[str, float]]:
    if EXPOSURES not in folder.files:
        return {}
    return parse_exposures(_read_text(folder, EXPOSURES, place), place.describe_folder(EXPOSURES))


def _read_text(folder: Folder, name: str, place: Place) -> str:
    try:
        return decode_text(place.read(folder.files[name].path))
    except UnicodeDecodeError as error:
        raise InputError(f"{place.describe_folder(name)}: not UTF-8 text") from error


def _make_frame(
    instant: Instant,
    images: Mapping[str, Mapping[str, FileEntry]],
    exposures: Mapping[str, Mapping[str, float]],
) -> RecordedFrame:
    assert instant.time_ns is not None  # of readings or of a rate
    files = {
        camera: f"{camera}/{own[instant.frame].path}"
        for camera, own in images.items()
        if instant.frame in own
    }
    return RecordedFrame(
        instant.frame,
        instant.time_ns,
        instant.position_mm,
        files,
        exposures.get(instant.frame, _NO_EXPOSURES),
    )


def _compute_digest(listing: CaptureListing, images: Mapping[str, Mapping[str, FileEntry]]) -> str:
    """Return the SHA-256 of names, sizes and stamps of all files that the recording is made of.

    An archive's own size and time belong to it: the stamps of its members stay when its bytes are damaged.
    """
    files = [(f"{camera}/{frame}", entry) for camera, own in images.items() for frame, entry in own.items()]
    files += [
        (name, listing.folder.files[name]) for name in (ENCODER, EXPOSURES) if name in listing.folder.files
    ]
    lines = (f"{name}\0{entry.path}\0{entry.size}\0{entry.stamp}\n" for name, entry in files)
    return sha256("".join([*lines, listing.tree.mark]).encode("utf-8", "surrogateescape")).hexdigest()
