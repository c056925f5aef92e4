"""A whole capture → the board's corners in every image, found in parallel."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beltscape.calibrate.corners import Corners, Sightings
from beltscape.calibrate.detect import Variant, detector, to_8_bit
from beltscape.calibrate.diagnose import describe_what_is_there
from beltscape.calibrate.steady import one_thread
from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.capture import Capture
from beltscape.files.images import read_image
from beltscape.target.board import Board, CharucoBoard

NOTHING_THERE = "they show neither ArUco markers nor a chessboard: look at exposure and focus"

Item = TypeVar("Item")
Result = TypeVar("Result")


def find_board(
    capture: Capture, board: Board, reporter: Reporter, *, variant: Variant | None = None
) -> tuple[Sightings, Variant]:
    """The board's corners in every image of a capture, and how the board turned out to be printed.

    Images that cannot be read or have another size than the rest of their camera are named and left out.

    Raises
    ------
    InputError
        When no image shows the board; the message says what the images show instead.
    """
    for line in capture.gaps():
        reporter.warn(line)
    if variant is None:
        variant = _find_variant(capture, board)
    detect = detector(board, variant)
    jobs = [(camera, frame, path) for camera, files in capture.files.items() for frame, path in files.items()]

    def look(job: tuple[str, str, Path]) -> tuple[tuple[int, int], Corners | None] | str:
        try:
            image = read_image(job[2])
        except InputError as error:
            return f"{error}; going on without this image"
        return (image.shape[1], image.shape[0]), detect(image)

    with one_thread():
        results = list(zip(jobs, _in_parallel(look, jobs, reporter, "finding the board"), strict=True))
    sightings = _collect(capture, results, reporter)
    if not sightings.cameras:
        raise InputError(f"{capture.folder}: none of its {len(jobs)} images can be read; copy them again")
    if not any(sightings.views.values()):
        raise InputError(_nothing_found(capture, board, variant))
    for camera, views in sightings.views.items():
        if not views and _mirrored(capture.only((camera,)), board, variant):
            reporter.warn(
                f"{capture.folder / camera}: the images are mirrored; switch mirroring off in the camera"
            )
    return sightings, variant


def _mirrored(capture: Capture, board: Board, variant: Variant) -> bool:
    """Whether the board shows once the images are flipped left to right."""
    detect = detector(board, variant)
    flipped = (np.ascontiguousarray(image[:, ::-1]) for image in _sample(capture, 6))
    return any(detect(image) is not None for image in flipped)


def _in_parallel(
    work: Callable[[Item], Result], items: list[Item], reporter: Reporter, stage: str
) -> Iterator[Result]:
    """Results in the order of the items, whatever the number of threads."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            for done, result in enumerate(pool.map(work, items), start=1):
                reporter.step(stage, done, len(items))
                yield result
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _collect(
    capture: Capture,
    results: list[tuple[tuple[str, str, Path], tuple[tuple[int, int], Corners | None] | str]],
    reporter: Reporter,
) -> Sightings:
    sizes: dict[str, tuple[int, int]] = {}
    views: dict[str, dict[str, Corners]] = {}
    for camera in capture.cameras:
        own = [(frame, path, result) for (name, frame, path), result in results if name == camera]
        for _, _, result in own:
            if isinstance(result, str):
                reporter.warn(result)
        read = [(frame, path, result) for frame, path, result in own if not isinstance(result, str)]
        if not read:
            reporter.warn(
                f"{capture.folder / camera}: none of its images can be read; going on without {camera}"
            )
            continue
        size = Counter(result[0] for _, _, result in read).most_common(1)[0][0]
        sizes[camera], views[camera] = size, {}
        for frame, path, (own_size, corners) in read:
            if own_size != size:
                reporter.warn(
                    f"{path}: {own_size[0]}×{own_size[1]} px, but {camera}'s other images have "
                    f"{size[0]}×{size[1]}; going on without this image"
                )
            elif corners is not None:
                views[camera][frame] = corners
    return Sightings(sizes, views, {name: len(capture.files[name]) for name in sizes})


def _sample(capture: Capture, count: int) -> Iterator[NDArray[np.uint8]]:
    """Up to ``count`` readable images, spread over cameras and frames."""
    frames = capture.frames
    order = [frames[i] for i in np.unique(np.linspace(0, len(frames) - 1, count).astype(int))]
    taken = 0
    for frame in order:
        for files in capture.files.values():
            if frame in files and taken < count:
                try:
                    image = to_8_bit(read_image(files[frame]))
                except InputError:
                    continue
                taken += 1
                yield image


def _find_variant(capture: Capture, board: Board) -> Variant:
    """Legacy or not, inverted or not: what board.toml leaves open is tried and told."""
    if not isinstance(board, CharucoBoard):
        return Variant()
    options = [
        Variant(legacy, inverted) for inverted in _open(board.inverted) for legacy in _open(board.legacy)
    ]
    return options[0] if len(options) == 1 else _most_corners(options, board, _sample(capture, 24))


def _open(flag: bool | None) -> tuple[bool, ...]:
    return (False, True) if flag is None else (flag,)


def _most_corners(options: list[Variant], board: Board, images: Iterable[NDArray[np.uint8]]) -> Variant:
    """The variant with the most corners; the first of equals. Stops as soon as one is clearly ahead."""
    counts = [0] * len(options)
    for image in images:
        for i, option in enumerate(options):
            corners = detector(board, option)(image)
            counts[i] += len(corners) if corners else 0
        best, second = sorted(counts, reverse=True)[:2]
        if best >= 60 and best > 3 * second:
            break
    return options[int(np.argmax(counts))]


def _nothing_found(capture: Capture, board: Board, variant: Variant) -> str:
    said = f"{capture.folder}: no image shows the board ({board.describe()})"
    if isinstance(board, CharucoBoard):
        others = [Variant(legacy, inverted) for inverted in (False, True) for legacy in (False, True)]
        best = _most_corners(others, board, _sample(capture, 12))
        if best != variant and any(detector(board, best)(image) for image in _sample(capture, 12)):
            return f"{said}, {variant.describe()}; the images fit {best.describe()}: correct board.toml"
    there = describe_what_is_there(_sample(capture, 12), board)
    return f"{said}; " + (f"they show {there}: correct board.toml" if there else NOTHING_THERE)
