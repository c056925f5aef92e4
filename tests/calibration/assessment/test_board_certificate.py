"""The certificate of a board: its σ is that of all lengths, by the scatter of rigs from boards of scattered sizes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.special import ndtri
from scipy.stats import chi2

from beltscape.calibration.assessment.board_size import CertifiedSize, estimate_board_size
from beltscape.calibration.assessment.covariance import (
    add_scale,
    compute_depth_sigma,
    compute_formal_covariance,
    compute_rig_covariance,
)
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.errors import InputError
from beltscape.core.geometry.rig import scale_rig
from beltscape.core.progress import Silent
from beltscape.target.board import corner_points_mm, parse_board
from tests.calibration.assessment.test_board_print import CHESSBOARD, RIG, adjust_views
from tests.calibration.test_bundle_adjustment import triangulate_with
from tests.synthetic.detections import make_detections
from tests.thorough import count_examples

DEPTH_MM, NOISE_PX, SCALE = 650.0, 0.05, 1.5e-3
"""σ of the board's size is 1 mm in depth, twice as much as the noise of the corners makes."""


def test_depth_scatters_with_the_size_of_the_board_as_its_certificate_says(rig, board, poses):
    count = count_examples(24)
    scales = SCALE * ndtri((np.arange(count) + 0.5) / count)
    np.random.default_rng(1).shuffle(scales)
    x, y = np.meshgrid(np.linspace(-120, 120, 5), np.linspace(-100, 100, 4))
    points = np.stack([x.ravel(), y.ravel(), np.full(x.size, DEPTH_MM)], axis=-1)
    errors, sigma, exact = [], [], []
    for seed, scale in enumerate(scales / np.sqrt(np.mean(scales**2)) * SCALE):
        printed = board.model_copy(
            update={"square_mm": board.square_mm * (1 + scale), "marker_mm": board.marker_mm * (1 + scale)}
        )
        seen = make_detections(rig, printed, poses, NOISE_PX, 300 + seed)
        found = adjust_bundle(solve_hierarchy(seen, board, rig.core, Silent()), board)
        matrix = compute_formal_covariance(found.rig, found.bundle, found.linearise())
        for values, own in ((sigma, add_scale(found.rig, matrix, SCALE)), (exact, matrix)):
            values.append(np.nanmedian(compute_depth_sigma(found.rig, own, DEPTH_MM, columns=9).sigma_mm))
        errors.append(triangulate_with(found.rig, rig, points)[:, 2] - DEPTH_MM)
    scatter_mm = float(np.sqrt(np.nanmedian(np.mean(np.square(errors), axis=0))))
    assert 0.75 < scatter_mm / np.mean(sigma) < 1.35
    assert scatter_mm > 1.4 * np.mean(exact)


def test_sigma_of_scale_moves_poses_and_depths_alike(rig, board, poses):
    seen = make_detections(rig, board, poses, NOISE_PX)
    found = adjust_bundle(solve_hierarchy(seen, board, rig.core, Silent()), board)
    plain = compute_rig_covariance(found)
    sized = add_scale(found.rig, plain.matrix, 0.01)
    added = dict(zip(plain.parameters, np.diag(sized - plain.matrix), strict=True))
    for name, pose in found.rig.cam_from_core.items():
        assert added[f"{name}.fx_px"] == 0
        if name != rig.core:
            assert added[f"{name}.turn_x_rad"] == 0
            shift = pose.translation_mm[0]
            assert added[f"{name}.shift_x_mm"] == pytest.approx((0.01 * shift) ** 2)
    depth = compute_depth_sigma(
        found.rig, sized - plain.matrix + 1e-18 * np.eye(len(sized)), 650.0, columns=5
    )
    known = depth.sigma_mm[np.isfinite(depth.sigma_mm)]
    np.testing.assert_allclose(known, 6.5, rtol=1e-3)  # 1 % of the depth


BY_AXIS = 0.5e-3, 2e-3
"""σ of lengths along rows and along columns of a board whose rows were measured better."""


def test_rows_that_are_known_better_than_columns_give_the_size_and_its_sigma():
    """The stretch that the views show says that the columns are off: σ is that of the rows, not of the mean."""
    drawn, count = corner_points_mm(CHESSBOARD), count_examples(24)
    certified = CHESSBOARD.model_copy(
        update={"square_sigma_mm": tuple(CHESSBOARD.square_mm * np.array(BY_AXIS))}
    )
    true_mm, rng = np.linalg.norm(RIG.cam_from_core["c"].center_mm), np.random.default_rng(1)
    off, plain, sigma = [], [], []
    for seed, (rows, columns) in enumerate((rng.normal(size=(count, 2)) * np.array(BY_AXIS)).tolist()):
        found = adjust_views(certified, drawn * [1 + rows, 1 + columns, 1], seed)
        size = estimate_board_size(certified, found, 1.0)
        assert not size.contradiction
        own = found.rig
        plain.append(np.linalg.norm(own.cam_from_core["c"].center_mm) / true_mm - 1)
        off.append(np.linalg.norm(size.resize(own).cam_from_core["c"].center_mm) / true_mm - 1)
        sigma.append(size.sigma)
    ratio = np.sqrt(np.mean(np.square(off))) / np.sqrt(np.mean(np.square(sigma)))
    least, most = (np.sqrt(chi2.ppf(p, count) / count) for p in (0.001, 0.999))  # of so few examples
    assert least < ratio < most if count < 24 else 0.8 < ratio < 1.25
    assert np.sqrt(np.mean(np.square(off))) < 0.8 * np.sqrt(np.mean(np.square(plain)))


def test_a_stretch_that_the_certificate_does_not_allow_is_said():
    certified = CHESSBOARD.model_copy(update={"square_sigma_mm": (0.003, 0.003)})
    found = adjust_views(certified, corner_points_mm(CHESSBOARD) * [1.004, 1, 1])
    size = estimate_board_size(certified, found, 1.0)
    assert "rows are +0.4" in size.contradiction
    assert "but its certificate allows ± 0.01%" in size.contradiction
    assert estimate_board_size(CHESSBOARD, found, 1.0) == CertifiedSize(1.0, 0.0)


def test_a_scaled_rig_keeps_the_sigma_of_its_lengths(rig):
    own = replace(rig, quality={"scale_sigma": 2e-4, "held_out": {"rms_px": 0.1}})
    half = scale_rig(own, 0.5)
    assert half.scale_sigma == 2e-4
    assert dict(half.quality) == {"scale_sigma": 2e-4}
    assert rig.scale_sigma == 0
    assert replace(rig, quality={"scale_sigma": float("nan")}).scale_sigma == 0


@pytest.mark.parametrize(
    ("board", "scale"),
    [
        ({"kind": "chessboard", "corners": [9, 6], "square_mm": 25, "square_sigma_mm": 0.005}, 2e-4),
        ({"kind": "chessboard", "corners": [9, 6], "square_mm": 25}, 0.0),
        ({"kind": "chessboard", "corners": [9, 6], "square_mm": 25, "square_sigma_mm": [0.006, 0.008]}, 2e-4),
        ({"kind": "aprilgrid", "tags": [6, 6], "tag_mm": 50, "spacing": 0.3, "tag_sigma_mm": 0.01}, 2e-4),
    ],
)
def test_a_board_states_the_sigma_of_its_size(board, scale):
    parsed = parse_board(Path("board.toml"), board)
    assert parsed.scale_sigma == pytest.approx(scale)
    assert ("±" in parsed.describe()) == (scale > 0)


@pytest.mark.parametrize(
    ("sigma", "line"),
    [
        (
            5,
            "square_sigma_mm = 5: must be at most 5% of the 25 mm; give one standard deviation of one such length",
        ),
        (-0.1, "square_sigma_mm"),
    ],
)
def test_an_impossible_sigma_is_refused(sigma, line):
    given = {"kind": "chessboard", "corners": [9, 6], "square_mm": 25, "square_sigma_mm": sigma}
    with pytest.raises(InputError) as error:
        parse_board(Path("board.toml"), given)
    assert line in str(error.value)
    assert "board.toml" in str(error.value)
