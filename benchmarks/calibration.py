"""Benchmark of the calibration: time, the rig against its truth, and held-out scores of recorded sets.

The times are seconds of the processor. "After global optimisation" contains the monocular, binocular and network
stages from given corners; "after joint adjustment" the bundle adjustment from there. The two are the solve; detection
stands in its own row, and held-out scores, covariance and report are in none.
"""

from __future__ import annotations

import time
from pathlib import Path

from beltscape.calibration.assessment.cross_validation import cross_validate
from beltscape.calibration.bundle_adjustment import adjust_bundle
from beltscape.calibration.detection.detect_capture import detect_board
from beltscape.calibration.hierarchy import solve_hierarchy
from beltscape.core.geometry.rig import Rig
from beltscape.core.progress import Silent
from beltscape.evaluate.depth_scores import score_rig_against_truth
from beltscape.files.capture import read_capture
from beltscape.kernels import load
from beltscape.target.board import Board, CharucoBoard, Chessboard, read_board
from captures import read_true_rig

RECORDED: dict[str, Board] = {
    "opencv_stereo": Chessboard(corners=(9, 6), square_mm=25),
    "pycamset_calibration_charuco": CharucoBoard(
        squares=(20, 20), square_mm=4, marker_mm=3.2, dictionary="DICT_4X4_1000"
    ),
    "caliscope_4cam": CharucoBoard(squares=(4, 5), square_mm=54, marker_mm=40.5, dictionary="DICT_4X4_1000"),
}


def calibration(rendered: Path) -> tuple[list[str], Rig | None]:
    """Return the tables and the rig calibrated from the rendered capture; missing captures are left out."""
    lines: list[str] = []
    calibrated = None
    if rendered.is_dir():
        lines, calibrated = _compare_with_truth(rendered)
    rows = [_held_out_row(name, rendered.parent / "real" / name, board) for name, board in RECORDED.items()]
    if any(rows):
        head = "| held out, recorded | cameras | RMS px | median px | square bias mm | square RMS mm | σ of halves |"
        lines += ["", head, "|---|---|---|---|---|---|---|", *(row for row in rows if row)]
    return lines, calibrated


def _compare_with_truth(rendered: Path) -> tuple[list[str], Rig]:
    truth = read_true_rig(rendered)
    board = read_board(rendered / "board.toml")
    start = time.process_time()
    detections, _ = detect_board(read_capture(rendered / "calibration"), board, Silent())
    detected = time.process_time()
    hierarchy = solve_hierarchy(detections, board, "cam0", Silent())
    associated = time.process_time()
    adjustment = adjust_bundle(hierarchy, board)
    done = time.process_time()
    pairs = Rig(
        hierarchy.rig.core,
        hierarchy.rig.cameras,
        (hierarchy.network.initial or hierarchy.network).cam_from_core,
    )
    rigs = {
        "detection": (None, detected - start),
        "pairs through the core": (pairs, None),
        "after global optimisation (Eqs. 17-20)": (hierarchy.rig, associated - detected),
        "after joint adjustment": (adjustment.rig, done - associated),
    }
    head = "| calibration, rendered | depth RMS / max mm | worst rotation ° | worst centre mm | CPU s |"
    rows = [_row(name, rig, truth, took) for name, (rig, took) in rigs.items()]
    return [head, "|---|---|---|---|---|", *rows], adjustment.rig


def _row(name: str, rig: Rig | None, truth: Rig, took: float | None) -> str:
    seconds = f"{took:.2f}" if took is not None else ""
    if rig is None:
        return f"| {name} | | | | {seconds} |"
    s = score_rig_against_truth(rig, truth, load())
    return (
        f"| {name} | {s.depth_rms_mm:.4f} / {s.depth_max_mm:.4f} | {max(s.rotation_deg.values()):.4f} | "
        f"{max(s.center_mm.values()):.4f} | {seconds} |"
    )


def _held_out_row(name: str, folder: Path, board: Board) -> str | None:
    if not folder.is_dir():
        return None
    detections, _ = detect_board(read_capture(folder), board, Silent())
    rig = solve_hierarchy(detections, board, None, Silent()).rig
    halves = cross_validate(detections.restrict(rig.cameras, detections.frames), board, rig.core, load())
    if halves is None:
        return None
    s = halves.score
    return (
        f"| {name} | {len(rig.cameras)} | {s.rms_px:.3f} | {s.median_px:.3f} | {s.square_bias_mm:+.4f} | "
        f"{s.square_rms_mm:.4f} | {halves.split_ratio:.1f} × |"
    )
