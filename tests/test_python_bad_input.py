"""Invalid arguments of Python callers raise a BeltscapeError that names the argument."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beltscape.core.arguments import require_depth_of, require_depth_range, require_image
from beltscape.core.depth import DepthMap
from beltscape.core.errors import BeltscapeError, InputError, ReconstructionError, SettingsError
from beltscape.core.frames import FrameSet
from beltscape.core.progress import Silent
from beltscape.files import belt_json, encoder_csv, exchange, images, ply, rig_json, stl, tiff
from beltscape.files.capture import read_capture
from beltscape.files.reconstruction import read_frame
from beltscape.files.rig_json import read_rig, write_rig
from beltscape.measure.belt.empty_belt import find_belt, learn_belt
from beltscape.stereo.multiview.reconstructor import MultiviewReconstructor
from beltscape.stereo.pairwise.reconstructor import PairwiseReconstructor
from beltscape.stereo.settings import PRESETS, MultiviewSettings, PairwiseSettings
from beltscape.target.board import read_board
from beltscape.target.module import read_module
from tests.synthetic.boards import row_of_cameras

RIG = row_of_cameras(["a", "b"])
WIDTH, HEIGHT = RIG.core_camera.size_px
RANGE_MM = (500.0, 900.0)
READERS = [
    read_rig, read_board, read_module, read_capture, read_frame, belt_json.read_belt, encoder_csv.read_encoder,
    images.read_image, ply.read_cloud, stl.read_stl, tiff.read_height_tiff, exchange.read_intrinsics,
]  # fmt: skip


def grey() -> np.ndarray:
    return np.full((HEIGHT, WIDTH), 90, np.uint8)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)
@pytest.mark.parametrize("path", [None, 3, b"rig.json", "", ["rig.json"]], ids=repr)
def test_what_is_no_path_is_named(reader, path):
    with pytest.raises(InputError, match=r"must be a path, as text or pathlib\.Path"):
        reader(path)


@pytest.mark.parametrize("reader", READERS, ids=lambda reader: reader.__name__)
def test_a_path_as_text_is_as_good_as_a_path(reader, tmp_path):
    """Of a file that is not there the same line is said."""
    lines = []
    for path in (tmp_path / "missing" / "file.png", str(tmp_path / "missing" / "file.png")):
        with pytest.raises(BeltscapeError) as error:
            reader(path)
        lines.append(str(error.value))
    assert lines[0] == lines[1]
    assert str(tmp_path) in lines[0]


@pytest.mark.parametrize("kind", [str, Path])
def test_a_rig_is_written_and_read_by_either(kind, tmp_path):
    write_rig(kind(tmp_path / "rig.json"), RIG)
    assert read_rig(kind(tmp_path / "rig.json")).core == RIG.core


def test_what_is_written_has_a_path_too():
    writers: list[tuple[Callable[..., None], object]] = [
        (rig_json.write_rig, RIG), (images.write_image, grey()), (ply.write_ply, None),
    ]  # fmt: skip
    for write, thing in writers:
        with pytest.raises(InputError, match="must be a path"):
            write(None, thing)


@given(st.sampled_from([np.float32, np.float64, np.int16, np.int64, np.bool_, np.complex64]))
def test_images_of_another_type_are_named(dtype):
    with pytest.raises(InputError, match=rf"^images\['b'\] is {np.dtype(dtype)}: must be uint8 or uint16"):
        FrameSet("000", {"a": grey(), "b": np.zeros((HEIGHT, WIDTH), dtype)})


@given(
    st.lists(st.integers(0, 5), max_size=4).filter(
        lambda s: (len(s) != 2 and not (len(s) == 3 and s[2] == 3)) or 0 in s
    )
)
def test_images_of_another_shape_are_named(shape):
    with pytest.raises(InputError) as error:
        require_image(np.zeros(shape, np.uint8), "image")
    assert str(error.value) == f"image has the shape {tuple(shape)}: must be (H, W) grey or (H, W, 3) RGB"


@given(
    st.tuples(st.integers(1, 9), st.integers(1, 9), st.sampled_from([(), (3,)])),
    st.sampled_from([np.uint8, np.uint16]),
)
def test_images_as_they_should_be_pass(shape, dtype):
    require_image(np.zeros((*shape[:2], *shape[2]), dtype), "image")


@pytest.mark.parametrize("wrong", [None, "cam0.png", [grey()], {"a": None}, {"a": [[1, 2], [3, 4]]}], ids=str)
def test_images_that_are_none_are_named(wrong):
    with pytest.raises(InputError, match=r"^images"):
        FrameSet("000", wrong)


@given(
    st.one_of(
        st.tuples(st.floats(), st.floats()).filter(lambda r: not (np.isfinite(r).all() and 0 < r[0] < r[1])),
        st.lists(st.floats(1, 2), max_size=5).filter(lambda r: len(r) != 2),
        st.sampled_from([None, 500.0, "near", ("a", "b"), (None, 3)]),
    )
)
def test_a_depth_range_that_cannot_be_is_named(wrong):
    with pytest.raises(InputError, match=r"^depth_range_mm = "):
        require_depth_range(wrong)


@pytest.mark.parametrize(
    "matcher",
    [
        lambda near_far: MultiviewReconstructor(RIG, near_far, MultiviewSettings()),
        lambda near_far: PairwiseReconstructor(RIG, near_far, PairwiseSettings()),
    ],
    ids=["multiview", "pairwise"],
)
@pytest.mark.parametrize("wrong", [(900, 500), (500, 500), (np.nan, 900), (500, np.inf), (-1, 900), 700])
def test_both_matchers_hold_their_depth_range(matcher, wrong):
    with pytest.raises(InputError, match=r"^depth_range_mm = "):
        matcher(wrong)


@given(st.text(max_size=12).filter(lambda name: name not in PRESETS))
def test_an_unknown_preset_is_named(name):
    with pytest.raises(SettingsError) as error:
        MultiviewSettings.preset(name)
    assert f"preset = {name!r} is not known; " in str(error.value)
    assert str(error.value).endswith("?") or "fast, standard" in str(error.value)


@given(st.one_of(st.integers(max_value=-1), st.integers(min_value=257)))
def test_threads_that_cannot_be_are_named(threads):
    with pytest.raises(SettingsError, match=f"threads = {threads}: must be "):
        MultiviewSettings(threads=threads)
    with pytest.raises(SettingsError, match=f"threads = {threads}: must be "):
        PairwiseSettings(threads=threads)


@pytest.mark.parametrize(
    ("update", "line"),
    [
        ({"threads": -1}, "threads = -1: must be greater than or equal to 0"),
        ({"tread": 2}, "unknown key tread; did you mean threads?"),
        ({"least_confidence": np.nan}, "least_confidence = nan"),
    ],
)
def test_settings_copied_with_what_cannot_be_are_found_by_the_matcher(update, line):
    settings = MultiviewSettings.preset("fast").model_copy(update=update)
    with pytest.raises(SettingsError) as error:
        MultiviewReconstructor(RIG, RANGE_MM, settings)
    assert line in str(error.value)


@pytest.mark.parametrize(
    ("images", "line"),
    [
        ({"a": grey()}, "no usable image of an auxiliary camera"),
        ({"b": grey()}, "no usable image of the core camera a"),
        ({"a": grey(), "b": grey(), "left": grey()}, "images of left, which the rig does not have; its"),
        ({"left": grey(), "right": grey()}, "images of left, right, which the rig does not have; its"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("method", ["multiview", "pairwise"])
def test_cameras_that_the_rig_does_not_have_are_named(images, line, method):
    matcher = (
        MultiviewReconstructor(RIG, RANGE_MM, MultiviewSettings.preset("fast"))
        if method == "multiview"
        else PairwiseReconstructor(RIG, RANGE_MM, PairwiseSettings())
    )
    with pytest.raises(ReconstructionError) as error:
        matcher.reconstruct(FrameSet("007", images), Silent())
    assert str(error.value).startswith("frame 007: ")
    assert line in str(error.value)


def depth_map(shape: tuple[int, ...]) -> DepthMap:
    values = np.full(shape, 700, np.float32)
    return DepthMap(values, values, np.ones(shape, np.uint8), values)


@given(st.lists(st.integers(1, 600), min_size=2, max_size=2).filter(lambda s: tuple(s) != (HEIGHT, WIDTH)))
def test_a_depth_map_of_another_grid_is_named(shape):
    with pytest.raises(InputError, match=f"^belt: the depth map is .*, the core camera {WIDTH}×{HEIGHT}; "):
        require_depth_of(RIG.core_camera, depth_map(tuple(shape)), "belt")


@pytest.mark.parametrize("wrong", [None, np.zeros((HEIGHT, WIDTH), np.float32), "depth.tiff"], ids=str)
def test_what_is_no_depth_map_is_named(wrong):
    with pytest.raises(InputError, match=r"^empty belt: depth is .*: must be a DepthMap"):
        find_belt(wrong, RIG.core_camera)
    with pytest.raises(InputError, match=r"^empty belt: depth is .*: must be a DepthMap"):
        learn_belt([wrong], RIG.core_camera)
