"""The frame that is matched: a GPU prepares it as the processor does, from images that are copied to it once."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from beltscape.core.frames import FrameSet
from beltscape.kernels import Kernels, load
from beltscape.kernels.cuda.emulated_device import EmulatedDevice
from beltscape.stereo.multiview.frame import MatchContext, PreparedFrame
from beltscape.stereo.multiview.preparation import prepare_frame
from tests.kernels.emulated import ON_EMULATION, backend_on
from tests.kernels.rounding import first_alike
from tests.stereo.scenes import make_ring, plane, quantise, render_images
from tests.thorough import list_cases

pytestmark = ON_EMULATION[0]
RIG = make_ring((0, 120), size_px=(64, 48))
NAMES = RIG.auxiliaries


def make_images(seed: int = 1) -> dict[str, np.ndarray]:
    """Return float32 images of different contrast."""
    images = render_images(RIG, (plane(),), noise=1.0, seed=seed)
    return {name: image * gain for (name, image), gain in zip(images.items(), (0.8, 1.0, 0.6), strict=True)}


def prepare(kernels: Kernels, images: dict[str, np.ndarray], step: int = 1) -> PreparedFrame:
    frame_set = FrameSet("000", {name: image.copy() for name, image in images.items()})
    return prepare_frame(frame_set, MatchContext.for_grid(RIG, NAMES, step, kernels, 1))


def assert_alike(found: PreparedFrame, expected: PreparedFrame, atol: float = 0.0) -> None:
    """The planes agree to ``atol``; the noise, for which OpenCV filters on the processor, to single precision."""
    for plane_of in (lambda p: [p.core], lambda p: p.images, lambda p: p.coefficients):
        for one, other in zip(plane_of(found), plane_of(expected), strict=True):
            np.testing.assert_allclose(np.asarray(one), np.asarray(other), rtol=0, atol=atol)
    for name in ("levels", "model", "texture", "floor"):
        assert float(getattr(found.noise, name)) == pytest.approx(
            float(getattr(expected.noise, name)), rel=1e-4
        )
    assert found.noise.demosaiced == expected.noise.demosaiced


@pytest.mark.parametrize("kind", [np.uint8, np.uint16])
def test_grey_images_are_copied_once_and_give_the_levels_of_the_processor_to_the_bit(kind):
    backend = backend_on(EmulatedDevice())
    kernels = Kernels(backend.resident)
    for seed in (1, 2):  # recorded, and as a graph
        images = {name: quantise(image, kind) for name, image in make_images(seed).items()}
        up, down = backend.traffic.uploaded_bytes, backend.traffic.downloaded_bytes
        found = prepare(kernels, images)
        size = sum(image.nbytes for image in images.values())
        assert size <= backend.traffic.uploaded_bytes - up < size + (20_000 if seed == 1 else 1000)
        assert backend.traffic.downloaded_bytes - down == 16, "four numbers, and no image, come down"
        expected = prepare(load(first_alike("emulated")), images)
        assert_alike(found, expected)
        if kind == np.uint8:  # whose sums of whole numbers are exact
            assert found.noise == expected.noise
    assert backend.graphs.counts.refused == {}


def test_images_of_colours_are_mixed_on_the_processor():
    tint = np.array([1.0, 0.7, 0.4])
    images = {name: quantise(image[..., None] * tint) for name, image in make_images().items()}
    images["cam1"] = images["cam1"][..., 0].copy()
    kernels = Kernels(backend_on(EmulatedDevice()).resident)
    assert_alike(prepare(kernels, images), prepare(load(first_alike("emulated")), images), atol=1e-3)


def test_blocks_are_averaged_on_a_coarser_grid():
    images = {name: quantise(image) for name, image in make_images().items()}
    kernels = Kernels(backend_on(EmulatedDevice()).resident)
    assert_alike(prepare(kernels, images, 2), prepare(load(first_alike("emulated")), images, 2), atol=1e-3)


@pytest.mark.parametrize("sigma_px", list_cases((2.0, 9.0), (2.0,)))
def test_auxiliaries_are_blurred_where_the_core_is_out_of_focus(sigma_px):
    images = {name: quantise(image) for name, image in make_images().items()}
    sharp = prepare(load(first_alike("emulated")), images)
    images["cam0"] = cv2.GaussianBlur(images["cam0"], (0, 0), sigma_px)
    expected = prepare(load(first_alike("emulated")), images)
    assert np.asarray(expected.images[0]).std() < 0.9 * np.asarray(sharp.images[0]).std()
    backend = backend_on(EmulatedDevice())
    assert_alike(prepare(Kernels(backend.resident), images), expected, atol=2e-3)
    assert backend.graphs.counts.refused == {}


def test_demosaiced_images_are_found():
    pattern = {name: quantise(image) for name, image in make_images().items()}
    images = {
        name: cv2.cvtColor(cv2.cvtColor(image, cv2.COLOR_BayerRGGB2RGB), cv2.COLOR_RGB2GRAY)
        for name, image in pattern.items()
    }
    expected = prepare(load(first_alike("emulated")), images)
    found = prepare(Kernels(backend_on(EmulatedDevice()).resident), images)
    assert_alike(found, expected)
    assert found.noise.demosaiced
