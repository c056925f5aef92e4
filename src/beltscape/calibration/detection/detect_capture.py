"""Detection of the board in every image of a capture, in parallel."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import islice
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from beltscape.calibration.detection.board_mismatch import describe_contradiction, describe_shown_board
from beltscape.calibration.detection.corners import BoardDetections, Corners
from beltscape.calibration.detection.detector import (
    Detector,
    PrintVariant,
    add_back_side,
    convert_to_8_bit,
    make_detector,
)
from beltscape.calibration.solver.levenberg_marquardt import single_thread
from beltscape.core.errors import InputError
from beltscape.core.progress import Reporter
from beltscape.files.camera_types import read_camera_types
from beltscape.files.capture import Capture
from beltscape.files.images import read_image
from beltscape.target.board import AprilGrid, Board, BoardSet, CharucoBoard

_GOING_ON = "; going on without this image"
NO_BOARD = "they show neither ArUco markers nor a chessboard: look at exposure and focus"

_COMPARED = 6
"""Images in which markers are compared with the board's description: one is enough, some may not show the board."""
SURE_CORNERS, SURE_RATIO = 60, 3
"""Corners found under one print variant, and their ratio to those under any other, from which it is certain: a wrong
variant finds a few corners by chance, never a third."""

_ENOUGH_IMAGES = 24
"""Images after which one of both is enough: small boards have few corners, and boards of an odd number of rows look
alike in both layouts."""

Item = TypeVar("Item")
Result = TypeVar("Result")


def detect_board(
    capture: Capture, board: Board, reporter: Reporter, *, variant: PrintVariant | None = None
) -> tuple[BoardDetections, PrintVariant]:
    """Detect the board's corners in every image of a capture, and the print variant of the board.

    Images that cannot be read, or whose size differs from the rest of their camera's, are reported and left out. A
    board with markers is also found from behind (`Corners.from_behind`), which a mirroring camera cannot be told from
    by one image.

    Raises
    ------
    InputError
        When no image shows the board; the message says what the images show instead.
    """
    for line in capture.describe_omissions():
        reporter.warn(line)
    if variant is None:
        variant = _find_variant(capture, board)
    detect = make_two_sided_detector(board, variant)
    jobs = [(camera, frame, path) for camera, files in capture.files.items() for frame, path in files.items()]

    def detect_in_file(job: tuple[str, str, Path]) -> tuple[tuple[int, int], Corners | None] | str:
        try:
            image = read_image(job[2])
        except InputError as error:
            return f"{error}{_GOING_ON}"
        return (image.shape[1], image.shape[0]), detect(image)

    with single_thread():
        results = list(
            zip(jobs, _map_parallel(detect_in_file, jobs, reporter, "finding the board"), strict=True)
        )
    detections = _collect_detections(capture, results, reporter)
    if not detections.cameras:
        reason = next(result for _, result in results if isinstance(result, str))
        raise InputError(
            f"{capture.folder}: none of its {len(jobs)} images can be read; the first: "
            f"{reason.removesuffix(_GOING_ON)}"
        )
    _check_description(capture, board, variant, detections, reporter)
    if not any(detections.views.values()):
        raise InputError(_describe_failure(capture, board, variant))
    return detections, variant


def _map_parallel(
    work: Callable[[Item], Result], items: list[Item], reporter: Reporter, stage: str
) -> Iterator[Result]:
    """Yield results in the order of the items, whatever the number of threads."""
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        try:
            for done, result in enumerate(pool.map(work, items), start=1):
                reporter.step(stage, done, len(items))
                yield result
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _collect_detections(
    capture: Capture,
    results: list[tuple[tuple[str, str, Path], tuple[tuple[int, int], Corners | None] | str]],
    reporter: Reporter,
) -> BoardDetections:
    sizes: dict[str, tuple[int, int]] = {}
    views: dict[str, dict[str, Corners]] = {}
    for camera in capture.cameras:
        camera_results = [(frame, path, result) for (name, frame, path), result in results if name == camera]
        for _, _, result in camera_results:
            if isinstance(result, str):
                reporter.warn(result)
        read = [
            (frame, path, result) for frame, path, result in camera_results if not isinstance(result, str)
        ]
        if not read:
            reporter.warn(
                f"{capture.folder / camera}: none of its images can be read; going on without {camera}"
            )
            continue
        size = Counter(result[0] for _, _, result in read).most_common(1)[0][0]
        sizes[camera], views[camera] = size, {}
        for frame, path, (image_size, corners) in read:
            if image_size != size:
                reporter.warn(
                    f"{path}: {image_size[0]}×{image_size[1]} px, but {camera}'s other images have "
                    f"{size[0]}×{size[1]}; going on without this image"
                )
            elif corners is not None:
                views[camera][frame] = corners
    images = {name: len(capture.files[name]) for name in sizes}
    return BoardDetections(sizes, views, images, read_camera_types(capture.folder))


def _read_spread(capture: Capture) -> Iterator[NDArray[np.uint8]]:
    """Yield every readable image of a capture: any first part of them is spread over all frames and all cameras."""
    frames, cameras = order_spread(capture.frames), list(capture.files)
    for turn in range(len(cameras)):
        for k, frame in enumerate(frames):
            path = capture.files[cameras[(k + turn) % len(cameras)]].get(frame)
            if path is not None:
                with suppress(InputError):
                    yield convert_to_8_bit(read_image(path))


def order_spread(items: Sequence[Item]) -> list[Item]:
    """Return the items in van der Corput's order: the first, the middle one, the quarters, the eighths and so on."""
    bits = max(len(items) - 1, 1).bit_length()
    return [items[i] for i in (int(f"{n:0{bits}b}"[::-1], 2) for n in range(1 << bits)) if i < len(items)]


def _find_variant(capture: Capture, board: Board) -> PrintVariant:
    """Return the print variant; keys that board.toml leaves open are determined from the images."""
    options = list_variants(board)
    if len(options) == 1:
        return options[0]
    return _select_variant(options, board, _read_spread(capture)) or options[0]


def list_variants(board: Board) -> list[PrintVariant]:
    """Return the ways in which a board may be printed, by the keys that board.toml leaves open."""
    charucos = list_charuco_boards(board)
    if not charucos:
        return [PrintVariant()]
    return [
        PrintVariant(legacy, inverted)
        for inverted in _list_options([charuco.inverted for charuco in charucos])
        for legacy in _list_options([charuco.legacy for charuco in charucos])
    ]


def list_charuco_boards(board: Board) -> list[CharucoBoard]:
    """Return the ChArUco boards among the described ones; those of a set have one print variant."""
    boards = [face.board for face in board.faces] if isinstance(board, BoardSet) else [board]
    return [each for each in boards if isinstance(each, CharucoBoard)]


def make_two_sided_detector(board: Board, variant: PrintVariant) -> Detector:
    """Return a detector of one board with markers from both sides, of other boards from the front only."""
    detect = make_detector(board, variant)
    return add_back_side(detect) if isinstance(board, CharucoBoard | AprilGrid) else detect


def _list_options(flags: list[bool | None]) -> tuple[bool, ...]:
    return tuple(sorted({flag for flag in flags if flag is not None})) or (False, True)


def _select_variant(
    options: list[PrintVariant], board: Board, images: Iterable[NDArray[np.uint8]]
) -> PrintVariant | None:
    """Return the variant with the most corners, the first of equal ones; None where no image shows any.

    Every variant is looked for until one is clearly ahead; in every image, where none shows any corners before.
    """
    counts = [0] * len(options)
    for read, image in enumerate(images, start=1):
        for i, option in enumerate(options):
            corners = make_two_sided_detector(board, option)(image)
            counts[i] += len(corners) if corners else 0
        best, second = sorted(counts, reverse=True)[:2]
        if sum((best >= SURE_CORNERS, best > SURE_RATIO * second, read >= _ENOUGH_IMAGES)) >= 2:
            break
    return options[int(np.argmax(counts))] if any(counts) else None


def _check_description(
    capture: Capture, board: Board, variant: PrintVariant, detections: BoardDetections, reporter: Reporter
) -> None:
    """Compare a ChArUco board's description with its markers: warn where they differ.

    Raises
    ------
    InputError
        When they differ and most images do not show the board as described.
    """
    if not isinstance(board, CharucoBoard):
        return
    sample = _read_shown(capture, detections)
    keys = describe_contradiction(sample, board, legacy=variant.legacy, inverted=variant.inverted)
    if keys is None:
        return
    found, images = sum(map(len, detections.views.values())), sum(detections.images.values())
    where = (
        f"{capture.folder}: {'no image shows' if not found else f'{found} of {images} images show'} the board"
    )
    message = f"{where} ({board.describe()}); the markers fit {keys}: correct board.toml"
    if 2 * found < images:
        raise InputError(message)
    reporter.warn(message)


def _read_shown(capture: Capture, detections: BoardDetections) -> Iterator[NDArray[np.uint8]]:
    """Yield some readable images that show the board, as it was detected; of all images where none does."""
    shown = [
        capture.files[camera][frame]
        for frame in order_spread(capture.frames)
        for camera, views in detections.views.items()
        if frame in views
    ]
    for path in shown[:_COMPARED]:
        yield convert_to_8_bit(read_image(path))
    if not shown:
        yield from islice(_read_spread(capture), _COMPARED)


def _describe_failure(capture: Capture, board: Board, variant: PrintVariant) -> str:
    message = f"{capture.folder}: no image shows the board ({board.describe()})"
    if isinstance(board, CharucoBoard):
        others = [PrintVariant(legacy, inverted) for inverted in (False, True) for legacy in (False, True)]
        best = _select_variant(others, board, _read_spread(capture))
        if best is not None and best != variant:
            return f"{message}, {variant.describe()}; the images fit {best.describe()}: correct board.toml"
    shown = describe_shown_board(lambda: _read_spread(capture), board)
    return f"{message}; " + (f"they show {shown}: correct board.toml" if shown else NO_BOARD)
