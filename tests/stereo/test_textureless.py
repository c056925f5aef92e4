"""Textureless discs are continued from smooth rims; all other pixels stay unchanged."""

from __future__ import annotations

from dataclasses import fields, replace

import numpy as np
import pytest

from beltscape.kernels import load
from beltscape.stereo.multiview.frame import PreparedFrame
from beltscape.stereo.multiview.surface import Surface, fit_slopes
from beltscape.stereo.multiview.textureless import fill_textureless_discs
from tests.stereo.scenes import DEPTH_MM, Scene, make_ring, make_scene, patch, plane, sphere, with_scale

SIZE_PX = (160, 140)
MIDDLE_PX = (80, 70)
RADIUS_PX = 20
BRIGHT = np.float32(150)
SMOOTH = {
    "plane": (plane(),),
    "slanted": (plane(DEPTH_MM, 0.3, -0.2),),
    "gentle curve": (sphere(640, 900), plane(1100)),
}
STEP = (plane(740), patch(660, (-150, 10)))
_DARK = {1.0: 70, 0.5: 110}
"""Levels subtracted, by scale, so that the speckle becomes dots on black."""


def fill(surface, prepared, scale):
    """Fill discs with no information in bright regions and equal information elsewhere."""
    information = np.where(prepared.core >= BRIGHT, 0.0, 1.0)
    found, where = fill_textureless_discs(surface, information, with_scale(prepared, scale))
    np.testing.assert_array_equal(found.s[~where], surface.s[~where])
    return found


def make_dotted_scene(*solids, scale: float = 1.0) -> Scene:
    """Return a scene lit by dots on black."""
    made = make_scene(*solids, rig=make_ring(size_px=SIZE_PX), noise=0.5)
    return replace(made, prepared=with_core(made, np.maximum(made.prepared.core - _DARK[scale], 0)))


def with_core(made: Scene, core: np.ndarray) -> PreparedFrame:
    return replace(made.prepared, core=core.astype(np.float32))


def mask_disc(radius_px: float, middle_px: tuple[float, float] = MIDDLE_PX) -> np.ndarray:
    u, v = np.meshgrid(np.arange(SIZE_PX[0]), np.arange(SIZE_PX[1]))
    return (u - middle_px[0]) ** 2 + (v - middle_px[1]) ** 2 <= radius_px**2


def corrupt(made: Scene, where: np.ndarray) -> Surface:
    """Return the true surface with the noise of matching, and random inside the mask."""
    rng = np.random.default_rng(5)
    s = made.s + rng.normal(0, 0.02, made.s.shape)
    s[where] += 1 + rng.normal(0, 0.7, int(where.sum()))
    return fit_slopes(s.astype(np.float32), load(), 1)


def same_bytes(a: Surface, b: Surface, where: np.ndarray | slice = slice(None)) -> bool:
    return all(
        getattr(a, f.name)[where].tobytes() == getattr(b, f.name)[where].tobytes() for f in fields(Surface)
    )


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("shape", SMOOTH)
def test_disc_is_continued_from_its_rim(shape, scale):
    made = make_dotted_scene(*SMOOTH[shape], scale=scale)
    marker = mask_disc(RADIUS_PX * scale)
    wrong = corrupt(made, marker)
    assert np.abs(wrong.s - made.s)[marker].max() > 2
    filled = fill(wrong, with_core(made, np.where(marker, BRIGHT, made.prepared.core)), scale)
    assert np.abs(filled.s - made.s)[marker].max() < 0.03
    true_v, true_u = np.gradient(made.s.astype(float))
    assert np.abs(filled.slope_u - true_u)[marker].max() < 0.005
    assert np.abs(filled.slope_v - true_v)[marker].max() < 0.005
    assert same_bytes(filled, wrong, ~mask_disc((RADIUS_PX + 10) * scale))


def test_slopes_of_a_filled_disc_are_those_of_its_s():
    made = make_dotted_scene(*SMOOTH["gentle curve"])
    marker = mask_disc(RADIUS_PX)
    filled = fill(corrupt(made, marker), with_core(made, np.where(marker, BRIGHT, made.prepared.core)), 1.0)
    by_v, by_u = np.gradient(filled.s.astype(float))
    inside = mask_disc(RADIUS_PX - 2)
    np.testing.assert_allclose(filled.slope_u[inside], by_u[inside], atol=1e-3)
    np.testing.assert_allclose(filled.slope_v[inside], by_v[inside], atol=1e-3)


def test_several_discs_are_filled_separately():
    made = make_dotted_scene(*SMOOTH["slanted"])
    markers = mask_disc(12, (40, 40)) | mask_disc(12, (112, 44)) | mask_disc(12, (76, 100))
    wrong = corrupt(made, markers)
    filled = fill(wrong, with_core(made, np.where(markers, BRIGHT, made.prepared.core)), 1.0)
    assert np.abs(filled.s - made.s)[markers].max() < 0.03


def test_size_of_discs_scales_with_the_grid():
    """A disc of 4 px is too small at full scale, one of 30 px too large at half scale."""
    made = make_dotted_scene(*SMOOTH["plane"], scale=0.5)
    for radius_px, scale in ((4, 0.5), (30, 1.0)):
        marker = mask_disc(radius_px)
        wrong, prepared = corrupt(made, marker), with_core(made, np.where(marker, BRIGHT, made.prepared.core))
        assert np.abs(fill(wrong, prepared, scale).s - made.s)[marker].max() < 0.03
        assert same_bytes(fill(wrong, prepared, 1.5 - scale), wrong)


def test_outliers_around_a_disc_do_not_change_it():
    made = make_dotted_scene(*SMOOTH["plane"])
    marker = mask_disc(RADIUS_PX)
    wrong = corrupt(made, marker)
    stray = np.random.default_rng(8).random(wrong.s.shape) < 0.05
    wrong = replace(wrong, s=np.where(stray & ~marker, wrong.s + 3, wrong.s).astype(np.float32))
    wrong.s[55:60, 20:60] = np.nan
    filled = fill(wrong, with_core(made, np.where(marker, BRIGHT, made.prepared.core)), 1.0)
    assert np.abs(filled.s - made.s)[marker].max() < 0.03


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("shift_px", [-8, 0, 8])
def test_disc_across_a_step_is_unchanged(shift_px, scale):
    made = make_dotted_scene(*STEP, scale=scale)
    edge = int(np.argmax(np.abs(np.diff(made.s[MIDDLE_PX[1]])[20:-20]))) + 20
    marker = mask_disc(RADIUS_PX * scale, (edge + shift_px * scale, MIDDLE_PX[1]))
    wrong = corrupt(made, marker)
    assert same_bytes(
        fill(wrong, with_core(made, np.where(marker, BRIGHT, made.prepared.core)), scale), wrong
    )


def test_disc_without_a_rim_is_unchanged():
    made = make_dotted_scene(*SMOOTH["plane"])
    marker = mask_disc(RADIUS_PX)
    alone = fit_slopes(np.where(marker, made.s, np.nan).astype(np.float32), load(), 1)
    assert same_bytes(fill(alone, with_core(made, np.where(marker, BRIGHT, made.prepared.core)), 1.0), alone)


@pytest.mark.parametrize("scale", [1.0, 0.5])
@pytest.mark.parametrize("shape", [*SMOOTH, "step"])
def test_ordinary_speckle_is_unchanged(shape, scale):
    made = make_dotted_scene(*SMOOTH.get(shape, STEP), scale=scale)
    surface = corrupt(made, mask_disc(RADIUS_PX * scale))
    assert same_bytes(fill(surface, made.prepared, scale), surface)


@pytest.mark.parametrize("bright", ["everywhere", "half", "nowhere"])
def test_image_without_dots_is_unchanged(bright):
    made = make_dotted_scene(*SMOOTH["gentle curve"])
    noise = np.random.default_rng(3).normal(0, 2, made.s.shape)
    columns = {"everywhere": slice(None), "half": slice(80, None), "nowhere": slice(0, 0)}[bright]
    core = np.zeros(made.s.shape)
    core[:, columns] = BRIGHT + noise[:, columns]
    surface = corrupt(made, mask_disc(RADIUS_PX))
    assert same_bytes(fill(surface, with_core(made, core), 1.0), surface)


def test_filling_does_not_modify_its_input():
    made = make_dotted_scene(*SMOOTH["plane"])
    marker = mask_disc(RADIUS_PX)
    wrong = corrupt(made, marker)
    kept = Surface(wrong.s.copy(), wrong.slope_u.copy(), wrong.slope_v.copy())
    filled = fill(wrong, with_core(made, np.where(marker, BRIGHT, made.prepared.core)), 1.0)
    assert same_bytes(wrong, kept)
    assert not same_bytes(filled, wrong)
