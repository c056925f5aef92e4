"""``beltscape target``: files, summaries and refused values."""

from __future__ import annotations

import argparse

import pytest

from beltscape.cli.commands import target
from beltscape.core.errors import InputError, SettingsError
from beltscape.core.progress import Silent
from beltscape.files.images import read_image
from beltscape.files.json_text import to_json
from beltscape.target.board import CharucoBoard, Chessboard, read_board
from beltscape.target.pattern_formats import read_pattern

CHARUCO = ["--squares=5", "4", "--square=30", "--marker=22", "--dictionary=DICT_5X5_100"]


def run(*words):
    parser = argparse.ArgumentParser()
    target.add_arguments(parser)
    flat = [part for word in words for part in str(word).split("=", 1)]
    return target.run(parser.parse_args(flat), Silent())


def test_pattern_writes_its_files_and_a_summary(tmp_path):
    result = run(
        *("pattern", "--out", tmp_path, "--size", 320, 200, "--dots", 600, "--seed", 4, "--bits", 16),
        *("--format", "tiff", "--grey", 0.5, 1, "--dot-color", "#ffffff"),
    )
    pattern = read_pattern(result["files"]["pattern"])
    assert (pattern.settings.count, pattern.settings.seed, pattern.settings.grey) == (600, 4, (0.5, 1))
    assert pattern.settings.dot_color == "#FFFFFF"
    assert read_image(result["files"]["image"]).shape == (200, 320, 3)
    assert {p.name for p in tmp_path.iterdir()} == {
        *("pattern.tiff", "pattern.svg", "pattern.json", "quality.json", "quality.png")
    }
    assert result["nearest_min_px"] > result["d_min_px"] == pattern.settings.d_min_px
    assert "600 dots on 320×200 px" in target.summary(result)
    assert '"low_frequency_power": 0.' in to_json(result)


@pytest.mark.parametrize(("preset", "dots"), [("paper", 25_000), ("fine", 50_000), ("dense", 100_000)])
def test_presets_are_numbers_of_dots(tmp_path, monkeypatch, preset, dots):
    asked = []
    monkeypatch.setattr("beltscape.target.pattern.make_pattern", lambda s: asked.append(s) or 1 / 0)  # pyrefly: ignore[division-by-zero]
    with pytest.raises(ZeroDivisionError):
        run("pattern", "--out", tmp_path, "--preset", preset)
    assert asked[0].count == dots
    assert asked[0].size_px == (1920, 1200)


def test_board_writes_its_files_and_instructions_to_print(tmp_path):
    result = run("board", "--out", tmp_path, *CHARUCO, "--page=A4", "--dpi=60")
    assert read_board(tmp_path / "board.toml").model_dump() == result["board"]
    assert result["page_mm"] == (210, 297) or result["page_mm"] == (297, 210)
    assert {p.name for p in tmp_path.iterdir()} == {"board.pdf", "board.svg", "board.png", "board.toml"}
    assert "print at 100 %" in target.summary(result)
    assert '"dictionary": "DICT_5X5_100"' in to_json(result)


def test_a_board_may_begin_with_another_marker(tmp_path):
    result = run("board", "--out", tmp_path, *CHARUCO, "--first-id", 40)
    board = read_board(result["files"]["toml"])
    assert isinstance(board, CharucoBoard)
    assert board.marker_ids == range(40, 50)
    other = run("board", "--out", tmp_path / "other", *CHARUCO)
    assert result["files"]["svg"].read_bytes() != other["files"]["svg"].read_bytes()
    with pytest.raises(SettingsError, match="--first-id 3: a chessboard has no markers"):
        run("board", "--out", tmp_path, "--corners=7", "5", "--square=30", "--first-id", 3)


def test_chessboard_is_described_by_its_inner_corners(tmp_path):
    run("board", "--out", tmp_path, "--corners=9", "6", "--square=20", "--dpi=50")
    assert read_board(tmp_path / "board.toml") == Chessboard(corners=(9, 6), square_mm=20)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["pattern", "--dots=0"], "target pattern: count = 0: must be greater than or equal to 1"),
        (["pattern", "--dot-color=gold"], "target pattern: dot_color = 'gold': a colour is written #RRGGBB"),
        (
            ["pattern", "--grey=1", "0.5"],
            "target pattern: grey = [1.0, 0.5]: the first level must be the smaller",
        ),
        (
            ["pattern", "--d-min=9"],
            "25000 dots do not fit 1920×1200 px at d_min 9 px; at most 18824 do, or d_min",
        ),
        (
            ["board", *CHARUCO, "--page=100x100"],
            "the board with margin, ruler and text needs 160×141 mm, more than",
        ),
        (["board", *CHARUCO, "--dpi=5"], "--dpi 5: give a resolution from 20 to 2400"),
        (
            ["board", *CHARUCO[:-1]],
            "--dictionary is missing; a ChArUco board needs --square MM and --marker MM and --dictionary",
        ),
        (
            ["board", *CHARUCO[:-2], "--marker=40", "--dictionary=DICT_5X5_100"],
            "target board: marker_mm = 40 must",
        ),
        (
            ["board", "--corners=9", "6", "--square=9", "--marker=3"],
            "--marker 3.0: a chessboard has no marker;",
        ),
    ],
)
def test_invalid_target_is_refused_in_one_line(tmp_path, words, message):
    with pytest.raises((InputError, SettingsError)) as error:
        run(words[0], "--out", tmp_path, *words[1:])
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)
