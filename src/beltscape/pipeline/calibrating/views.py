"""Views of a board: captures of images or frames of videos, and the boards detected in them.

Views from behind are distinguished from mirrored ones; those of a set of boards are split into views of single ones.

A video of a moving board has hundreds of frames, most blurred by motion or nearly alike. Of every few successive
frames the sharpest is a candidate, in the camera that is blurred most; among the candidates those are chosen, one
after the other, that differ most from all chosen before (farthest-point sampling).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from beltscape.calibration.detection.corners import BoardDetections, Corners, drop_beyond_domains
from beltscape.calibration.detection.detect_capture import detect_board
from beltscape.calibration.detection.detector import PrintVariant
from beltscape.calibration.network.two_sides import Side, classify_back_views
from beltscape.core.arrays import Array
from beltscape.core.errors import InputError
from beltscape.core.frames import to_grey
from beltscape.core.geometry.camera import Camera
from beltscape.core.progress import Reporter
from beltscape.files.capture import (
    Capture,
    list_camera,
    list_capture,
    list_folder,
    list_images,
    list_loose_files,
)
from beltscape.files.frame_names import natural_key
from beltscape.files.images import VIDEO_EXTENSIONS, read_video, write_image
from beltscape.files.paths import summarise_names
from beltscape.target.board import Board, BoardSet


def read_board_views(folder: Path) -> Capture:
    """Read a capture, or a folder of one camera's images, which is named as the folder."""
    images, line = list_camera(folder) if folder.is_dir() else ({}, "")
    if images and not any(list_images(below) for below in folder.iterdir() if below.is_dir()):
        return Capture(folder, {folder.resolve().name: images}, {"": (line,)} if line else {})
    return list_capture(folder)


def has_board_views(folder: Path) -> bool:
    """Return whether a path is a folder of images, or of folders of images."""
    if not folder.is_dir():
        return False
    return bool(list_images(folder)) or any(
        list_images(below) for below in folder.iterdir() if below.is_dir()
    )


def split_boards(detections: BoardDetections, board: Board) -> BoardDetections:
    """Return the detections with a frame for each board of a set: ``frame/board``; of one board as they are."""
    if not isinstance(board, BoardSet):
        return detections
    views = {
        name: {
            f"{frame}/{face.name}": part
            for frame, corners in own.items()
            for face, part in zip(board.faces, _split_corners(corners, board), strict=True)
            if len(part)
        }
        for name, own in detections.views.items()
    }
    return replace(detections, views=views)


def _split_corners(corners: Corners, board: BoardSet) -> list[Corners]:
    face = np.searchsorted(board.offsets, corners.ids, side="right") - 1
    return [corners.select(face == number) for number in range(len(board.faces))]


def detect_rig_board(
    capture: Capture, board: Board, reporter: Reporter, *, known: Mapping[str, Camera] | None = None
) -> tuple[BoardDetections, PrintVariant]:
    """Detect the board in the images of a rig's cameras; the views of mirroring cameras are left out with a warning.

    Corners beyond the lens's domain of a ``known`` camera are left out.

    Raises
    ------
    InputError
        When no image shows the board, or all images are mirrored.
    """
    detections, variant = detect_board(capture, board, reporter)
    detections = drop_beyond_domains(detections, known or {})
    if isinstance(board, BoardSet):
        return detections, variant
    sides = classify_back_views(detections, board, known)
    seeing = [name for name, views in detections.views.items() if views]
    if sides and set(seeing) == set(sides):
        raise InputError(
            f"{capture.folder}: every camera finds the board in mirrored images only; switch mirroring off in the "
            "cameras, or, if all see a board of glass from behind, turn it round"
        )
    mirrored: dict[str, Side] = {name: side for name, side in sides.items() if side != "behind"}
    for name, side in mirrored.items():
        reporter.warn(f"{capture.folder / name}: {_describe_side(side)}")
    views = {name: own for name, own in detections.views.items() if name not in mirrored}
    views = {name: views.get(name, {}) for name in detections.views}
    return replace(detections, views=views), variant


def _describe_side(side: Side) -> str:
    if side == "mirrored":
        return "the images are mirrored; switch mirroring off in the camera"
    return (
        "the board is found in mirrored images only, and fewer than three views shared with another camera tell "
        "whether the camera mirrors or sees it from behind; going on without these views"
    )


FRAMES_FOLDER = "frames"
"""Folder of the chosen frames below the output folder."""
MAX_FRAMES = 60
"""Frames that are chosen at most: more add little to a calibration, and each costs time."""
CANDIDATE_STRIDE = 5
"""Successive frames of which the sharpest is a candidate: at 30 Hz the board barely moves within 0.17 s."""
MIN_NOVELTY = 0.15
"""Least difference from a chosen frame, as a share of the greatest difference between candidates."""
THUMBNAIL = (32, 24)
"""Width and height of the image that frames are compared in: it shows where the board is, not its squares."""
SHARPNESS_WIDTH = 640
"""Width of the image of which the sharpness is taken; noise of single pixels averages out."""


def find_videos(folder: Path) -> dict[str, Path]:
    """Return a folder's videos by camera, the file's stem, in natural order; InputError if one is there twice."""
    if not folder.is_dir():
        return {}
    videos: dict[str, Path] = {}
    for path in sorted(folder.iterdir(), key=lambda p: natural_key(p.name)):
        if path.suffix.lower() in VIDEO_EXTENSIONS and not path.name.startswith("."):
            if path.stem in videos:
                raise InputError(f"{path}: camera {path.stem} is there twice (also {videos[path.stem].name})")
            videos[path.stem] = path
    return videos


def locate_capture(folder: Path, out: Path, reporter: Reporter, *, synchronous: bool) -> Path:
    """Return the folder itself or, if it holds videos instead of images, that of frames extracted below ``out``."""
    if not find_videos(folder) or has_board_views(folder):
        return folder
    return extract_frames(folder, out / FRAMES_FOLDER, reporter, synchronous=synchronous).folder


def extract_frames(folder: Path, out: Path, reporter: Reporter, *, synchronous: bool) -> Capture:
    """Write chosen frames of a folder's videos as a capture into ``out``, named by their numbers, and read it.

    The frames of ``synchronous`` videos have the same numbers in every camera, otherwise each its own.

    Raises
    ------
    InputError
        When a video cannot be decoded, or synchronous ones have different numbers of frames.
    """
    videos = find_videos(folder)
    others = [name for name in list_loose_files(list_folder(folder)) if Path(name).stem not in videos]
    if others:
        kinds = ", ".join(VIDEO_EXTENSIONS)
        reporter.warn(f"{folder}: {summarise_names(others)} left out: videos are {kinds}")
    summaries: dict[str, tuple[Array, Array]] = {}
    for done, (name, path) in enumerate(videos.items(), start=1):
        summaries[name] = _summarise(path)
        reporter.step("reading videos", done, len(videos))
    if synchronous:
        _require_equal_lengths(videos, summaries)
        joint = select_frames(list(summaries.values()))
        chosen = dict.fromkeys(videos, joint)
    else:
        chosen = {name: select_frames([summary]) for name, summary in summaries.items()}
    for done, (name, path) in enumerate(videos.items(), start=1):
        _write_frames(path, chosen[name], out / name)
        reporter.step("writing frames", done, len(videos))
    return list_capture(out)


def _summarise(path: Path) -> tuple[Array, Array]:
    """Return a video's sharpness (F,) and thumbnails (F, h·w)."""
    import cv2

    sharpness: list[float] = []
    thumbnails: list[Array] = []
    for image in read_video(path):
        grey = to_grey(image)
        scale = min(1.0, SHARPNESS_WIDTH / grey.shape[1])
        small = cv2.resize(grey, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        sharpness.append(float(cv2.Laplacian(small, cv2.CV_32F).var()))
        thumbnails.append(
            cv2.resize(small, THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float64).ravel()
        )
    return np.array(sharpness), np.stack(thumbnails)


def _require_equal_lengths(videos: Mapping[str, Path], summaries: Mapping[str, tuple[Array, Array]]) -> None:
    counts = {name: len(sharpness) for name, (sharpness, _) in summaries.items()}
    if len(set(counts.values())) > 1:
        listed = ", ".join(f"{videos[name].name} {count}" for name, count in counts.items())
        raise InputError(
            f"{next(iter(videos.values())).parent}: the videos have different numbers of frames ({listed}), so that "
            "frames of the same number are not of one instant; cut them to the same frames"
        )


def select_frames(cameras: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return the numbers of the chosen frames, ascending, from each camera's sharpness (F,) and thumbnails (F, n)."""
    sharpness = np.min([_normalise(values) for values, _ in cameras], axis=0)
    thumbnails = np.concatenate([values for _, values in cameras], axis=1)
    starts = range(0, len(sharpness), CANDIDATE_STRIDE)
    candidates = np.array(
        [start + int(np.argmax(sharpness[start : start + CANDIDATE_STRIDE])) for start in starts]
    )
    # a candidate may still be blurred throughout its interval
    candidates = candidates[sharpness[candidates] >= 0.5 * np.median(sharpness[candidates])]
    views = thumbnails[candidates]
    chosen = [int(np.argmax(sharpness[candidates]))]
    distance = np.linalg.norm(views - views[chosen[0]], axis=1)
    least = MIN_NOVELTY * float(distance.max())
    while len(chosen) < min(MAX_FRAMES, len(candidates)):
        following = int(np.argmax(distance))
        if distance[following] <= least:
            break
        chosen.append(following)
        distance = np.minimum(distance, np.linalg.norm(views - views[following], axis=1))
    return tuple(sorted(int(number) for number in candidates[chosen]))


def _normalise(sharpness: Array) -> Array:
    """Return the sharpness relative to the camera's own median, so that lenses of different contrast compare."""
    return sharpness / max(float(np.median(sharpness)), 1e-12)


def _write_frames(path: Path, numbers: Sequence[int], folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    wanted = set(numbers)
    for number, image in enumerate(read_video(path)):
        if number in wanted:
            write_image(folder / f"{number:06d}.png", image)
