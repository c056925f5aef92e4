"""The preview of a simulated frame: the image of every camera, and the true depth of the core."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beltscape.core.frames import FrameSet
from beltscape.report.drawing.legend import NEAR_TO_FAR, Rgb, Scale
from beltscape.report.drawing.pictures import Panel, arrange_panels, quantile_range, to_rgb


def draw_simulated_frame(frame_set: FrameSet, depth_mm: NDArray[np.float64], columns: int = 3) -> Rgb:
    """Return (H, W, 3) RGB: the cameras' images, brightened, and the core's true depth (H, W)."""
    scale = Scale(*quantile_range(depth_mm), NEAR_TO_FAR)
    panels = [Panel(to_rgb(image), name) for name, image in frame_set.images.items()]
    panels.append(Panel(scale.to_rgb(depth_mm), "true depth, mm", scale))
    return arrange_panels(panels, columns)
