"""Images of a speckle pattern with markers on a plane, drawn with known centres."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

PATTERN_PX = (1920, 1200)
MARKER_RADIUS_PX = 26.0
MARKERS = np.array(
    [[(c + 0.5) * PATTERN_PX[0] / 4, (r + 0.5) * PATTERN_PX[1] / 4] for r in range(4) for c in range(4)]
).reshape(4, 4, 2)
"""(4, 4, 2) x, y of the markers by row and column, pattern px."""
DOT_STEP_PX = 9.6


@cache
def place_dots() -> np.ndarray:
    """Return (N, 2) dots on a jittered grid, as dense as 25,000 on the pattern, none on a marker."""
    rng = np.random.default_rng(5)
    x, y = np.meshgrid(np.arange(5, PATTERN_PX[0], DOT_STEP_PX), np.arange(5, PATTERN_PX[1], DOT_STEP_PX))
    positions = np.stack([x.ravel(), y.ravel()], axis=1) + rng.uniform(-1.3, 1.3, (x.size, 2))
    distance = np.linalg.norm(positions[:, None] - MARKERS.reshape(-1, 2), axis=-1).min(axis=1)
    return positions[distance > MARKER_RADIUS_PX + 4]


def project_points(points: np.ndarray, image_from_pattern: np.ndarray) -> np.ndarray:
    """Return the (..., 2) pixels of points on the pattern."""
    mapped = points @ image_from_pattern[:, :2].T + image_from_pattern[:, 2]
    return mapped[..., :2] / mapped[..., 2:]


def render_pattern(
    image_from_pattern: np.ndarray,
    size_px: tuple[int, int] = (816, 680),
    *,
    hidden: np.ndarray | None = None,
    exposure: float = 1.0,
    cast: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ambient: float = 6.0,
    noise: float = 1.0,
    speckle: bool = True,
    seed: int = 0,
) -> np.ndarray:
    """Return (H, W, 3) uint8 RGB; ``hidden`` (4, 4) bool leaves markers out, ``cast`` multiplies the channels."""
    width, height = size_px
    light = np.zeros((2 * height, 2 * width, 3), np.float32)  # drawn at twice the resolution, then averaged

    def draw(points: np.ndarray, radius: float, color: tuple[float, float, float]) -> None:
        around = np.linspace(0, 2 * np.pi, 25)[:-1]
        circle = radius * np.stack([np.cos(around), np.sin(around)], axis=-1)
        outlines = 2 * project_points(points[:, None] + circle, image_from_pattern) + 0.5
        cv2_outlines = [np.rint(o * 16).astype(np.int32) for o in outlines]
        for outline in cv2_outlines:
            cv2.fillConvexPoly(light, outline, color, cv2.LINE_8, 4)

    if speckle:
        draw(place_dots(), 2.6, (120.0, 82.0, 0.0))
        shown = MARKERS.reshape(-1, 2) if hidden is None else MARKERS[~hidden]
        draw(shown, MARKER_RADIUS_PX, (120.0, 0.0, 0.0))
    light = cv2.resize(light, size_px, interpolation=cv2.INTER_AREA)
    light = cv2.GaussianBlur(light, (0, 0), 0.6) + np.float32(ambient)
    counts = exposure * light * np.array(cast, np.float32)
    counts = counts + np.random.default_rng(seed).normal(0, noise, counts.shape)
    return np.clip(np.rint(counts), 0, 255).astype(np.uint8)


def make_view(size_px: tuple[int, int] = (816, 680), turn_deg: float = 0.0, slant: float = 0.0) -> np.ndarray:
    """Return the (3, 3) image_from_pattern: centred, turned, and by ``slant`` larger on the left than the right."""
    cos, sin = np.cos(np.deg2rad(turn_deg)), np.sin(np.deg2rad(turn_deg))
    center = np.array([[1, 0, -PATTERN_PX[0] / 2], [0, 1, -PATTERN_PX[1] / 2], [0, 0, 1.0]])
    scale = 0.9 * size_px[0] / PATTERN_PX[0] / (abs(cos) + 0.625 * abs(sin))
    turned = np.array([[scale * cos, -scale * sin, 0], [scale * sin, scale * cos, 0], [slant / 960, 0, 1]])
    back = np.array([[1, 0, size_px[0] / 2], [0, 1, size_px[1] / 2], [0, 0, 1.0]])
    return back @ turned @ center


def compute_luminance(rgb: np.ndarray) -> np.ndarray:
    """Return the (H, W) uint8 image of a monochrome camera."""
    return np.rint(rgb @ np.array([0.45, 0.45, 0.1])).astype(np.uint8)
