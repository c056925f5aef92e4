"""Recognition of demosaiced images by their 2 × 2 pattern of sharpness."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.stereo.multiview.photometry import are_demosaiced, compute_grey_levels, compute_phase_ratio
from tests.stereo.scenes import make_ring, make_scene, plane, prepare_scene, quantise, render_images

METHODS = {
    "bilinear": cv2.COLOR_BayerRGGB2RGB,
    "bilinear, another phase": cv2.COLOR_BayerGBRG2RGB,
    "edge-aware": cv2.COLOR_BayerRGGB2RGB_EA,
    "variable number of gradients": cv2.COLOR_BayerRGGB2RGB_VNG,
}


@cache
def render_texture(noise: float, dot_px: float = 1.3) -> np.ndarray:
    """Return a (240, 320) uint8 image of a textured plane."""
    rig = make_ring((0,), size_px=(320, 240))
    return quantise(render_images(rig, (plane(700, 0.2, 0.1),), noise=noise, dot_px=dot_px)["cam0"])


def compute_level(image: np.ndarray) -> np.ndarray:
    return compute_grey_levels({"cam0": image}, "cam0")["cam0"]


def compress_jpeg(image: np.ndarray, quality: int) -> np.ndarray:
    return np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, quality])[1], -1))


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
@pytest.mark.parametrize("noise", [0.5, 6.0])
@pytest.mark.parametrize(
    "after", [lambda i: i, lambda i: cv2.cvtColor(i, cv2.COLOR_RGB2GRAY), lambda i: compress_jpeg(i, 90)]
)
def test_demosaicing_is_recognised_in_colour_grey_and_jpeg(method, noise, after):
    assert are_demosaiced([compute_level(after(cv2.cvtColor(render_texture(noise), method)))])


@pytest.mark.parametrize("dot_px", [0.6, 1.3, 3.0])
@pytest.mark.parametrize("noise", [0.0, 1.0, 8.0])
@pytest.mark.parametrize(
    "change",
    [
        lambda i: i,
        lambda i: cv2.GaussianBlur(i, (0, 0), 1.0),
        lambda i: compress_jpeg(i, 75),
        lambda i: cv2.resize(i, None, fx=0.6, fy=0.6, interpolation=cv2.INTER_AREA),
        lambda i: cv2.resize(i, None, fx=1.5, fy=1.5),
        lambda i: np.stack([i, i, i // 2], axis=-1),
    ],
)
def test_other_images_are_not_recognised_as_demosaiced(change, noise, dot_px):
    assert not are_demosaiced([compute_level(change(render_texture(noise, dot_px)))])


def test_constant_and_tiny_images_have_no_pattern():
    assert compute_phase_ratio(np.full((6, 7), 3.0, np.float32)) == 1.0
    assert compute_phase_ratio(np.zeros((2, 2), np.float32)) == 1.0


def test_majority_of_the_cameras_decides():
    one, other = (
        compute_level(cv2.cvtColor(render_texture(1.0), cv2.COLOR_BayerRGGB2RGB)),
        compute_level(render_texture(1.0)),
    )
    assert not are_demosaiced([one, other, other])
    assert are_demosaiced([one, one, other])


def test_prepared_frame_records_demosaicing():
    rig = make_ring()
    images = {
        name: cv2.cvtColor(quantise(image), cv2.COLOR_BayerRGGB2RGB)
        for name, image in render_images(rig, (plane(),), noise=1.0).items()
    }
    assert prepare_scene(rig, FrameSet("000", images)).noise.demosaiced
    assert not make_scene(plane(), noise=1.0).prepared.noise.demosaiced
