"""Detections of boards by the bytes of their images, so that a run of the tests finds each board once.

Most tests that calibrate read the same few captures, and finding the board takes most of their time. What a detector
returns depends on nothing but the image, the board and its print variant. Tests of the detectors call these directly,
and a test of threads or of repetitions does so by ``detect_anew``.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Generator, Iterable
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any
from uuid import uuid4

import numpy as np
import pytest

from beltscape.calibration.detection import detect_capture
from beltscape.calibration.detection.corners import Corners
from beltscape.calibration.detection.detector import Detector, PrintVariant
from beltscape.target.board import Board

_KEPT = ("make_detector", "describe_contradiction", "describe_shown_board")
"""What the detection in a capture calls, and finds in the store instead."""


@dataclass(frozen=True, slots=True)
class DetectionStore:
    """A folder of results, shared by all workers of a run."""

    folder: Path

    def obtain(self, parts: Iterable[Any], images: Iterable[np.ndarray], compute: Callable[[], Any]) -> Any:
        """Return the kept result for the same parts and images, or compute it."""
        digest = sha256(repr(list(parts)).encode())
        for image in images:
            digest.update(f"{image.shape}{image.dtype}".encode())
            digest.update(np.ascontiguousarray(image).data)
        path = self.folder / digest.hexdigest()
        if path.is_file():
            return pickle.loads(path.read_bytes())
        result = compute()
        written = path.with_suffix(f".{uuid4().hex}")  # threads may compute the same result at a time
        written.write_bytes(pickle.dumps(result))
        written.replace(path)
        return result

    def make_detector(self, board: Board, variant: PrintVariant) -> Detector:
        """Return a detector that computes the corners in an image only where nothing is kept."""
        detect = REAL["make_detector"](board, variant)

        def find(image: np.ndarray) -> Corners | None:
            return self.obtain(("corners", board, variant), [image], lambda: detect(image))

        return find

    def describe_contradiction(
        self, images: Iterable[np.ndarray], board: Board, **printed: bool
    ) -> str | None:
        """Return what the markers in images show, computed once."""
        views = list(images)
        describe = REAL["describe_contradiction"]
        parts = ("contradiction", board, sorted(printed.items()))
        return self.obtain(parts, views, lambda: describe(views, board, **printed))

    def describe_shown_board(
        self, read_images: Callable[[], Iterable[np.ndarray]], board: Board
    ) -> str | None:
        """Return the board that images show, computed once."""
        views = list(read_images())
        return self.obtain(
            ("shown", board), views, lambda: REAL["describe_shown_board"](lambda: views, board)
        )


REAL = {name: getattr(detect_capture, name) for name in _KEPT}


@contextmanager
def use_detection_store(folder: Path) -> Generator[None]:
    """Let captures be searched through the store until the context ends."""
    store = DetectionStore(folder)
    with pytest.MonkeyPatch.context() as patch:
        for name in _KEPT:
            patch.setattr(detect_capture, name, getattr(store, name))
        yield


@contextmanager
def detect_anew() -> Generator[None]:
    """Let captures be searched by the detectors themselves until the context ends."""
    with pytest.MonkeyPatch.context() as patch:
        for name, real in REAL.items():
            patch.setattr(detect_capture, name, real)
        yield
