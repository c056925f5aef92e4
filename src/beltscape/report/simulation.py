"""A simulated frame at a glance: what every camera sees, and the true depth before the core."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.report.pictures import Rgb, beside, colored, panel, span, to_rgb


def simulated_picture(frame_set: FrameSet, depth_mm: NDArray[np.float64], columns: int = 3) -> Rgb:
    """(H, W, 3) RGB: the cameras' images, brightened, and the core's true depth (H, W) in its undistorted image."""
    near, far = span(depth_mm)
    panels = [panel(to_rgb(image), name) for name, image in frame_set.images.items()]
    panels.append(panel(colored(-depth_mm, -far, -near), "true depth", (far, near, "mm")))
    height = max(p.shape[0] for p in panels)
    panels = [np.pad(p, ((0, height - p.shape[0]), (0, 0), (0, 0))) for p in panels]
    panels += [np.zeros_like(panels[0])] * (-len(panels) % columns)
    rows = [beside(panels[i : i + columns]) for i in range(0, len(panels), columns)]
    return np.ascontiguousarray(np.concatenate(rows))
