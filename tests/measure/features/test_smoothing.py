"""The model of the matcher's smoothing equals the matcher, and corrects the radii of spheres."""

from __future__ import annotations

import numpy as np
import pytest

from beltscape.core.depth import DepthMap
from beltscape.core.geometry.camera import Camera
from beltscape.core.geometry.pose import Pose
from beltscape.core.geometry.rig import Rig
from beltscape.measure.features.face import compute_rays
from beltscape.measure.features.smoothing import Smoothing, detect_grid_step, estimate_smoothing
from beltscape.measure.features.sphere import fit_sphere
from beltscape.stereo.multiview.frame import choose_windows
from beltscape.stereo.settings import MultiviewSettings

WIDTH, HEIGHT = 612, 512


def rig() -> Rig:
    camera = Camera("cam0", (WIDTH, HEIGHT), np.array([580.0, 580.0]), np.array([305.5, 255.5]), np.zeros(5))
    beside = {f"cam{k + 1}": Pose(np.eye(3), -300.0 * np.array(way)) for k, way in enumerate(WAYS)}
    return Rig("cam0", dict.fromkeys(("cam0", *beside), camera), {"cam0": Pose.identity(), **beside})


WAYS = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0))


def speckled() -> np.ndarray:
    """(H, W) dots on a grey surface."""
    generator = np.random.default_rng(3)
    image = np.full((HEIGHT, WIDTH), 0.2)
    rows, columns = np.mgrid[:HEIGHT, :WIDTH]
    for x, y in generator.uniform((200, 150), (412, 362), (900, 2)):
        window = (slice(int(y) - 4, int(y) + 6), slice(int(x) - 4, int(x) + 6))
        far = np.hypot(rows[window] - y, columns[window] - x)
        image[window] = np.maximum(image[window], 0.2 + 0.8 / (1 + np.exp((far - 1.3) / 0.35)))
    return image


def depth_of(z: np.ndarray, sigma_mm: float = 0.05) -> DepthMap:
    z = z.astype(np.float32)
    there = np.isfinite(z)
    confidence = np.random.default_rng(0).uniform(0.8, 1, z.shape).astype(np.float32) * there
    return DepthMap(z, np.where(there, np.float32(sigma_mm), np.nan), 4 * there.astype(np.uint8), confidence)


def sphere_depth(radius_mm: float, center: np.ndarray) -> np.ndarray:
    rays = compute_rays(rig().core_camera, *np.mgrid[:HEIGHT, :WIDTH])
    a, b = np.sum(rays**2, axis=-1), rays @ center
    with np.errstate(invalid="ignore"):
        return (b - np.sqrt(b * b - a * (center @ center - radius_mm**2))) / a


def test_the_passes_are_those_of_the_matcher():
    """Who changes the matcher's windows, tolerances or twicing has to look at the spheres again."""
    for preset, width, step in (("standard", 1224, 1), ("fast", 1224, 2), ("standard", 612, 1)):
        settings, size = MultiviewSettings.preset(preset), choose_windows(width // step)
        assert settings.step(width) == step
        confidence = np.kron(np.random.default_rng(0).uniform(size=(64, 64)), np.ones((step, step)))
        fields = np.ones((64 * step,) * 2, np.float32)
        depth = DepthMap(fields, fields, fields.astype(np.uint8), confidence.astype(np.float32))
        smoothing = estimate_smoothing(np.ones_like(fields), depth, rig())
        assert smoothing.step == step
        assert smoothing.passes.twicing == settings.twicing
        expected = [
            (settings.round_tolerances_px[-1], size.narrow),
            (settings.final_tolerance_px, size.wide),
        ]
        scaled = Smoothing(smoothing.information, step, size.scale, 1.0, smoothing.passes)
        assert [(t, scaled.radii(sigmas)) for t, sigmas in scaled.passes.fits] == expected


def test_blocks_of_a_coarser_grid_are_recognised():
    generator = np.random.default_rng(1)
    fine = generator.uniform(size=(40, 60)).astype(np.float32)
    coarse = np.kron(fine, np.ones((2, 2), np.float32))
    maps = [DepthMap(c, c, c.astype(np.uint8), c) for c in (fine, coarse, np.ones_like(fine))]
    assert [detect_grid_step(depth) for depth in maps] == [1, 2, 1]


@pytest.mark.parametrize("radius_mm", [20.0, 35.0, 50.0])
def test_a_sphere_that_the_matcher_smoothed_has_its_radius(radius_mm):
    """The fit takes off what the smoothing added; without the correction the radius would be several σ too small."""
    center = np.array([0.0, 0.0, 730.0])
    true, image = sphere_depth(radius_mm, center), speckled()
    smoothing = estimate_smoothing(image, depth_of(true), rig())
    window = (slice(100, 412), slice(150, 462))
    seen = np.full_like(true, np.nan)
    seen[window] = smoothing.smooth(true[window], window)
    noise = 1e-3 * np.random.default_rng(2).normal(size=seen.shape)
    ball = fit_sphere(
        depth_of(seen + noise), rig().core_camera, np.isfinite(true), center, radius_mm * 1.01, smoothing
    )
    assert ball is not None
    assert ball.corrected_mm > 0.005
    assert abs(ball.radius_mm - radius_mm) < min(0.01, 2 * ball.sigma_mm)


def test_an_exact_sphere_is_not_corrected():
    center, image = np.array([0.0, 0.0, 730.0]), speckled()
    true = sphere_depth(35.0, center)
    smoothing = estimate_smoothing(image, depth_of(true), rig())
    ball = fit_sphere(depth_of(true), rig().core_camera, np.isfinite(true), center, 35.0, smoothing)
    assert ball is not None
    assert ball.corrected_mm == 0
    assert ball.radius_mm == pytest.approx(35.0, abs=0.002)
