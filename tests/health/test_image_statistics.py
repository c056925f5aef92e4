"""Statistics of an image on which the checks of images rest."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.health.image_statistics import compute_levels, compute_statistics


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65_535)])
def test_a_saturated_channel_counts_although_the_grey_level_is_lower(dtype: type, full: int) -> None:
    image = np.full((320, 400, 3), full // 5, dtype)
    image[:, :160, 0] = full  # red light: the mean of the channels stays below half of the range
    statistics = compute_statistics(image, compute_levels(image))
    assert statistics.saturated_share == pytest.approx(0.4)
    assert statistics.mean_level < 128
    grey = image[..., 0]
    assert compute_statistics(grey, compute_levels(grey)).saturated_share == pytest.approx(0.4)
