"""Pictures as they are written, held by what they must show: the colour at the place of a known mark."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import cv2
import numpy as np
import pytest
from matplotlib.colors import to_rgb  # pyrefly: ignore[missing-import]
from matplotlib.figure import Figure

import beltscape as bs
from beltscape.calibration.assessment.coverage import CameraCoverage, Coverage, MeasuringVolume
from beltscape.core.frames import FrameSet
from beltscape.files.images import decode_image
from beltscape.files.tiff import read_float_tiff
from beltscape.report.blue_noise import draw_quality
from beltscape.report.calibration_plots import STATES, coverage_picture, draw_coverage
from beltscape.report.control_pictures import draw_simulated_frame
from beltscape.report.drawing.palette import light
from beltscape.report.drawing.plots import WIDE, draw_dots, draw_lines, make_panels, to_png, use_decimal_mark
from beltscape.report.notebook import plot, plot_records
from beltscape.target.blue_noise import measure_blue_noise
from beltscape.target.pattern import PatternSettings, make_pattern
from beltscape.target.pattern_formats import draw_pattern
from tests.report.material import belt, flow, lumps
from tests.synthetic.boards import row_of_cameras
from tests.synthetic.demo import TRUE_RIG


@cache
def decode(png: bytes) -> np.ndarray:
    return decode_image(png, "picture").astype(int)


def save(figure: Any) -> bytes:
    """Return the PNG that a reader of the manual writes by ``figure.savefig``."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", facecolor="white")
    return buffer.getvalue()


def color_share(picture: np.ndarray) -> float:
    """Return the share of pixels that are no greys."""
    return float((np.ptp(picture, axis=2) > 60).mean())


def has_color(picture: np.ndarray, role: str) -> bool:
    """Return whether more than some single pixels have the colour of a role."""
    wanted = np.rint(np.array(to_rgb(light(role))) * 255)
    return int((np.abs(picture - wanted).max(axis=2) < 12).sum()) > 200


def is_marked(figure: Any, png: bytes, axis: int, place: Any, role: str, radius_px: int = 2) -> bool:
    """Return whether the colour of a role is in a figure's picture at a place of an axis, in data units."""
    picture = decode(png)
    u, v = figure.axes[axis].transData.transform(np.asarray(place, float)) * len(picture) / figure.bbox.height
    row, column = round(len(picture) - v), round(u)
    around = picture[row - radius_px : row + radius_px + 1, column - radius_px : column + radius_px + 1]
    wanted = np.rint(np.array(to_rgb(light(role))) * 255)
    return bool((np.abs(around - wanted).max(axis=2) < 40).any())


@pytest.mark.parametrize("write", [to_png, save])
@pytest.mark.parametrize("count", [1, 3, 1500])
def test_dots_and_lines_are_in_the_picture(write: Callable[[Figure], bytes], count: int) -> None:
    figure, (axis,) = make_panels(1, WIDE)
    places = np.random.default_rng(3).uniform(0, 1000, (count, 2))
    draw_dots(axis, places, 6.0, light("missing"))
    draw_lines(axis, np.array([[[1200.0, 100.0], [1300.0, 900.0]]]), color=light("first"), linewidth=2.0)
    axis.set(xlim=(-100, 1400), ylim=(-100, 1100))
    png = write(figure)
    assert all(is_marked(figure, png, 0, place, "missing") for place in places)
    assert is_marked(figure, png, 0, (1250, 500), "first")
    assert not is_marked(figure, png, 0, (1350, 50), "missing")


def make_coverage() -> Coverage:
    """Three cameras whose points are certain above, uncertain in the middle and unusable below.

    The board was at the left of each part.
    """
    rig = row_of_cameras(["a", "b", "c"], 90.0, 500.0)
    width, height = rig.cameras["a"].size_px
    u, v = np.meshgrid(np.linspace(20, width - 20, 15), np.linspace(20, height - 20, 12))
    pixels = np.stack([u, v], axis=-1).reshape(-1, 2)
    third = pixels[:, 1] * 3 // height
    none = np.zeros(len(pixels), bool)
    corners = np.array([[width / 2 + 7.0, height / 6 + 3.0], [width / 3, height / 3]])
    cameras = {
        name: CameraCoverage(
            replace(camera, valid_radius_px=width / 3), pixels, pixels[:, 0] < width / 5, none, corners
        )
        for name, camera in rig.cameras.items()
    }
    sigma = np.full(len(pixels), 0.1)
    volume = MeasuringVolume("the belt", np.zeros((len(pixels), 3)), is_given=True)
    return Coverage(volume, cameras, sigma, sigma, third >= 1, third >= 2)


def test_coverage_shows_states_corners_and_the_lens() -> None:
    coverage = make_coverage()
    figure = draw_coverage(coverage, WIDE)
    png = to_png(figure)
    for k, own in enumerate(coverage.cameras.values()):
        state = np.where(own.is_reached, 0, 1 + coverage.is_uncertain.astype(int) + coverage.is_unusable)
        for pixel, role in zip(own.pixels, np.array(STATES)[state], strict=True):
            assert is_marked(figure, png, k, pixel.round(), role), (k, pixel, role)
        for corner in own.corners_px:
            assert is_marked(figure, png, k, corner, "quiet")
        radius = own.camera.valid_radius_px
        assert is_marked(figure, png, k, own.camera.center_px + np.array([0, radius]), "limit")
    assert color_share(decode(png)) > 0.05


def test_a_refusal_shows_its_reason_and_the_cameras_with_most_gaps() -> None:
    """Of 20 cameras only the last one has a gap: it is drawn, and eight are not."""
    coverage = make_coverage()
    own = coverage.cameras["a"]
    reached = replace(own, is_reached=np.ones(len(own.pixels), bool))
    cameras = {f"c{k:02d}": reached for k in range(19)} | {"c19": own}
    many = replace(coverage, cameras=cameras)
    plain, refused = (
        coverage_picture(many),
        coverage_picture(many, "Refused: the board never came there. " * 6),
    )
    assert decode(refused).shape[0] > decode(plain).shape[0] > 1000
    for role in STATES:
        assert has_color(decode(plain), role), role
    all_reached = replace(coverage, cameras={"c00": reached})
    assert not has_color(decode(coverage_picture(all_reached)), "missing")


def test_plots_show_their_results() -> None:
    rig = row_of_cameras(["a", "b", "c"], 90.0, 500.0)
    figure = plot(rig)
    png = save(figure)
    for name, pose in rig.cam_from_core.items():
        for axis, (u, v) in enumerate(((0, 1), (0, 2))):
            role = "core" if name == rig.core else "auxiliary"
            assert is_marked(figure, png, axis, pose.center_mm[[u, v]], role), (name, axis)

    figure = plot(belt())
    png = save(figure)
    for k in (3, 20, 37):
        assert is_marked(figure, png, 0, (belt().x_mm[k], belt().z_mm[k]), "first"), k

    records = flow().records
    figure = plot_records(records)
    png = save(figure)
    for record in records:
        middle = (float(np.mean(record.strip_mm)), record.area_mm2 / 100)
        assert is_marked(figure, png, 0, middle, record.quality), record
        assert record.time_ns is not None
        assert is_marked(figure, png, 1, (record.time_ns / 1e9, record.volume_flow_m3_h), record.quality), (
            record
        )

    measured = lumps()[0]
    figure = plot(measured)
    png = save(figure)
    assert color_share(decode(png)) > 0.004


def test_depth_and_volume_are_filled_with_colour_within_the_box() -> None:
    rig = bs.read_rig(TRUE_RIG)
    empty, loaded = (read_true_depth(scene) for scene in ("belt_empty", "belt_loaded"))
    volume = bs.measure_volume(loaded, bs.learn_belt([empty], rig), rig, along_mm=(-150, 150))
    for result, least in ((loaded, 0.4), (volume, 0.2)):
        for write in (to_png, save):
            assert color_share(decode(write(plot(result)))) > least, result
    figure = plot(volume)
    png = save(figure)
    (left, right), (below, above) = volume.across_mm, volume.along_mm
    for place in ((left, 0.0), (right, 0.0), (0.0, below), (0.0, above)):
        assert is_marked(figure, png, 0, place, "limit"), place


def read_true_depth(scene: str) -> bs.DepthMap:
    depth = read_float_tiff(TRUE_RIG.parent / f"{scene}_depth.tiff")
    known = np.isfinite(depth)
    sigma = np.where(known, np.float32(0.1), np.float32(np.nan))
    return bs.DepthMap(depth, sigma, known.astype(np.uint8), known.astype(np.float32))


@pytest.mark.thorough
def test_quality_of_a_pattern_shows_a_piece_of_it_and_both_curves() -> None:
    pattern = make_pattern(PatternSettings(size_px=(400, 300)))
    image = draw_pattern(pattern)
    picture = decode(draw_quality(image, measure_blue_noise(pattern)))
    third = picture.shape[1] // 3
    piece, nearest, spectrum = (picture[:, k * third : (k + 1) * third] for k in range(3))
    assert (piece.max(axis=2) < 60).mean() > 0.1  # the ground between the dots
    assert color_share(piece) > 0.1
    assert color_share(nearest) > 0.02
    assert color_share(spectrum) > 0.004


def test_preview_of_a_simulation_shows_every_image_and_the_depth() -> None:
    rng = np.random.default_rng(1)
    coarse = [rng.integers(0, 256, (9, 12)).astype(np.uint8) for _ in range(2)]
    images = {name: cv2.resize(each, (120, 90)) for name, each in zip("ab", coarse, strict=True)}
    depth = np.tile(np.linspace(600, 700, 120), (90, 1))
    picture = draw_simulated_frame(FrameSet("0", images), depth)
    assert color_share(picture.astype(int)) > 0.1
    for each in coarse:
        shown = cv2.resize(each, (776, 582), interpolation=cv2.INTER_LINEAR)
        found = cv2.matchTemplate(picture[..., 1], shown, cv2.TM_CCOEFF_NORMED)
        assert found.max() > 0.9


def test_ticks_have_the_decimal_mark_of_the_language():
    panels: tuple[Any, list[Any]] = make_panels(1, WIDE)
    figure, (axis,) = panels
    axis.barh([0, 1], [0.25, 0.5])
    axis.set_yticks([0, 1], ["v. 1", "v. 2"])
    use_decimal_mark([axis], ",")
    figure.draw_without_rendering()
    assert "0,1" in [one.get_text() for one in axis.get_xticklabels()]
    assert [one.get_text() for one in axis.get_yticklabels()] == ["v. 1", "v. 2"]
