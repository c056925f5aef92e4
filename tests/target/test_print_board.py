"""Printed sheets: true size in PDF, SVG and PNG."""

from __future__ import annotations

import re
import struct
import xml.etree.ElementTree as ET
from itertools import pairwise

import cv2
import numpy as np
import pytest

from beltscape.calibration.detection.detector import PrintVariant, make_detector
from beltscape.core.errors import SettingsError
from beltscape.files.images import read_image
from beltscape.target.board import AprilGrid, CharucoBoard, Chessboard, corner_points_mm, read_board
from beltscape.target.print_board import (
    PAPERS_MM,
    RULER_MM,
    choose_page,
    lay_out,
    make_ruler,
    write_board_files,
)
from beltscape.target.sheet import Sheet, draw_sheet, sheet_to_pdf, sheet_to_svg
from tests.optional import require

CHARUCO = CharucoBoard(squares=(12, 9), square_mm=30, marker_mm=22, dictionary="DICT_5X5_100")
SMALL = CharucoBoard(squares=(5, 4), square_mm=25.4, marker_mm=18.1, dictionary="DICT_4X4_50")
APRIL = CharucoBoard(squares=(5, 8), square_mm=20, marker_mm=15, dictionary="DICT_APRILTAG_36h11")
CHESS = Chessboard(corners=(9, 6), square_mm=25)


def pdf_shapes(data: bytes):
    """Rectangles (R, 4) and polygons of a PDF's page in mm, y down from its top; and its size in mm."""
    width, height = (float(v) for v in require(re.search(rb"/MediaBox \[0 0 (\S+) (\S+)\]", data)).groups())
    length = require(re.search(rb"/Length (\d+) >>\nstream\n", data))
    start = length.end()
    stream = data[start : start + int(length[1])].decode().split("\n")
    a, b, c, d, e, f, _ = stream[0].split()
    assert (b, c, e) == ("0", "0", "0") and a == d[1:]
    assert float(f) == pytest.approx(height, abs=1e-6)
    scale = float(a) * 25.4 / 72
    boxes = np.array([line.split()[:4] for line in stream if line.endswith(" re")], dtype=float) * scale
    polygons, open_ = [], []
    for line in stream:
        if line.endswith((" m", " l")):
            open_.append([float(v) * scale for v in line.split()[:2]])
        elif line == "h":
            polygons.append(np.array(open_))
            open_ = []
    return (width * 25.4 / 72, height * 25.4 / 72), boxes, tuple(polygons)


def svg_shapes(text: str):
    root = ET.fromstring(text)
    size = tuple(float(root.attrib[key].removesuffix("mm")) for key in ("width", "height"))
    assert [float(v) for v in root.attrib["viewBox"].split()] == [0, 0, *size]
    boxes, letters = (e.attrib["d"] for e in root.iter("{http://www.w3.org/2000/svg}path"))
    found = re.findall(r"M(\S+) (\S+?)h(\S+?)v(\S+?)h(\S+?)z", boxes)
    assert all(float(there) == -float(back) for _, _, there, _, back in found)
    polygons = [
        np.array([[float(v) for v in point.split()] for point in part.strip(" M").split("L")])
        for part in letters.split("z")[:-1]
    ]
    return size, np.array(found, dtype=float)[:, :4], tuple(polygons)


@pytest.mark.parametrize("board", [CHARUCO, SMALL, CHESS])
def test_pdf_and_svg_agree_in_true_millimetres(board):
    sheet = lay_out(board).sheet
    for size, boxes, polygons in (pdf_shapes(sheet_to_pdf(sheet)), svg_shapes(sheet_to_svg(sheet))):
        np.testing.assert_allclose(size, sheet.size_mm, atol=1e-6)
        np.testing.assert_allclose(boxes, sheet.rectangles_mm, atol=2e-6)
        assert len(polygons) == len(sheet.outlines_mm) > 50
        for got, want in zip(polygons, sheet.outlines_mm, strict=True):
            np.testing.assert_allclose(got, want, atol=2e-6)


def test_pdf_is_well_formed_and_requests_no_scaling():
    data = sheet_to_pdf(lay_out(SMALL).sheet)
    assert data.startswith(b"%PDF-1.6\n") and data.endswith(b"%%EOF\n")
    table = int(require(re.search(rb"startxref\n(\d+)", data))[1])
    assert data[table:].startswith(b"xref\n0 6\n")
    for index, start in enumerate(re.findall(rb"(\d{10}) 00000 n", data[table:]), start=1):
        assert data[int(start) :].startswith(b"%d 0 obj\n" % index)
    assert b"/PrintScaling /None" in data
    assert b"Date" not in data


@pytest.mark.parametrize(
    ("board", "dpi", "error_px"),
    [(CHARUCO, 127, 0.02), (APRIL, 127, 0.02), (CHARUCO, 151.3, 0.09), (SMALL, 200, 0.09)],
)
def test_opencv_finds_every_corner_of_the_page_rebuilt_from_its_pdf(board, dpi, error_px):
    """Where corners fall between pixels the detector is exact; elsewhere its own error is up to 0.09 px."""
    printed = lay_out(board)
    size, boxes, polygons = pdf_shapes(sheet_to_pdf(printed.sheet))
    image = draw_sheet(Sheet(size, "", boxes, polygons), dpi)
    corners, ids, _, _ = cv2.aruco.CharucoDetector(board.to_opencv(legacy=False)).detectBoard(image)
    want = (corner_points_mm(board)[:, :2] + printed.origin_mm) * dpi / 25.4 - 0.5
    assert corners is not None and ids is not None
    assert sorted(ids.ravel()) == list(range(len(want)))
    assert np.abs(corners.reshape(-1, 2) - want[ids.ravel()]).max() < error_px


def test_a_printed_aprilgrid_is_found_as_it_is_described(tmp_path):
    """Kalibr's tags stand upside down in OpenCV's eyes; the detector knows, and so must the print."""
    grid = AprilGrid(tags=(4, 3), tag_mm=40, spacing=0.3, first_id=5)
    printed, dpi = lay_out(grid), 127
    files = write_board_files(tmp_path, printed, dpi)
    assert read_board(files["toml"]) == grid
    corners = make_detector(grid, PrintVariant())(read_image(files["png"]))
    want = (grid.corners_mm() + printed.origin_mm) * dpi / 25.4 - 0.5
    assert corners is not None and len(corners) == len(want)
    assert np.abs(corners.pixels - want).max() < 0.05


@pytest.mark.parametrize("dpi", [96, 151.3, 300])
@pytest.mark.parametrize("board", [SMALL, CHESS])
def test_edges_in_the_image_are_at_their_positions_on_the_board(board, dpi):
    """The ink between the middle of a white square and that of a black one tells where the edge is, exactly."""
    printed = lay_out(board)
    image = draw_sheet(printed.sheet, dpi)
    ink = 1 - image / 255.0
    scale, (x0, y0) = dpi / 25.4, printed.origin_mm
    square, (columns, rows) = board.square_mm, board.grid
    # a white square's rim is free of its marker
    clear = (square - board.marker_mm) / 2 if isinstance(board, CharucoBoard) else square / 2
    for row in range(rows):
        for column in range(1, columns + 1):
            at = round((y0 + (row + 0.5) * square) * scale)
            edge = (x0 + column * square) * scale
            low, high = int(edge - clear * scale) + 2, int(edge + clear * scale) - 2
            black_left = (row + column) % 2 == 1
            span = ink[at, low:high].sum()
            assert (low + span if black_left else high - span) == pytest.approx(edge, abs=0.003)
    for column in range(columns):
        edge = (y0 + square) * scale
        at = round((x0 + (column + 0.5) * square) * scale)
        low, high = int(edge - clear * scale) + 2, int(edge + clear * scale) - 2
        span = ink[low:high, at].sum()
        assert (low + span if column % 2 == 0 else high - span) == pytest.approx(edge, abs=0.003)


def test_drawn_board_equals_the_drawing_of_opencv():
    """10 px a mm: every pixel as in OpenCV's image of the board, but for marker bits of broken width."""
    board = CHARUCO.model_copy(update={"marker_mm": 21.0})  # 7 bits of 3 mm
    printed = lay_out(board)
    image = draw_sheet(printed.sheet, 254)
    x, y = (round(v * 10) for v in printed.origin_mm)
    ours = image[y : y + 2700, x : x + 3600]
    theirs = board.to_opencv(legacy=False).generateImage((3600, 2700))
    assert (ours != theirs).mean() < 1e-3


def test_chessboard_is_found_in_the_image():
    printed = lay_out(CHESS)
    image = draw_sheet(printed.sheet, 127)
    found, corners = cv2.findChessboardCorners(image, CHESS.corners)
    assert found
    corners = cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), (3, 100, 1e-5)).reshape(-1, 2)
    want = (corner_points_mm(CHESS)[:, :2] + printed.origin_mm) * 5 - 0.5
    distance = np.linalg.norm(corners[:, None] - want, axis=2)
    assert distance.min(axis=1).max() < 0.02
    assert sorted(distance.argmin(axis=1)) == list(range(54))


def test_ruler_is_100_mm_between_its_end_ticks():
    x, _, width, _ = make_ruler().T
    middles = (x + width / 2)[1:]
    np.testing.assert_allclose(middles, np.arange(101), atol=1e-12)
    assert RULER_MM == 100


@pytest.mark.parametrize("board", [SMALL, CHESS])
def test_board_files_are_reproducible_and_the_toml_reads_back(tmp_path, board):
    printed = lay_out(board)
    files = write_board_files(tmp_path / "a", printed, 100)
    again = write_board_files(tmp_path / "b", lay_out(board), 100)
    assert all(files[kind].read_bytes() == again[kind].read_bytes() for kind in files)
    assert read_board(files["toml"]) == printed.board
    if isinstance(board, CharucoBoard):
        text = files["toml"].read_text()
        assert "legacy = false\ninverted = false\n" in text
    assert read_image(files["png"]).shape == draw_sheet(printed.sheet, 100).shape
    data = files["png"].read_bytes()
    at = data.index(b"pHYs")
    assert struct.unpack(">IIB", data[at + 4 : at + 13]) == (3937, 3937, 1)


@pytest.mark.parametrize(
    ("needed", "page", "size"),
    [
        ((150, 100), None, (297, 210)),
        ((150, 200), None, (210, 297)),
        ((250, 290), None, (297, 420)),
        ((370, 291), None, (420, 297)),
        ((210, 297), None, (210, 297)),
        ((100, 50), "a3", (420, 297)),
        ((100, 50), "120x80.5", (120, 80.5)),
        ((50, 100), "200×150", (200, 150)),
        ((1100, 800), None, (1189, 841)),
    ],
)
def test_page_is_chosen_in_the_better_orientation(needed, page, size):
    assert choose_page(needed, page) == size


@pytest.mark.parametrize(
    ("needed", "page", "message"),
    [
        ((370, 291), "A4", "needs 370×291 mm, more than page A4; give page A3, or smaller squares"),
        ((370, 291), "380x290", "needs 370×291 mm, more than page 380x290; give page A3, or smaller squares"),
        ((1300.2, 900), None, "needs 1301×900 mm, more than A0; give page 1301x900, or smaller squares"),
        ((9000, 900), None, "needs 9000×900 mm, more than A0; give smaller squares"),
        (
            (10, 10),
            "B5",
            "page 'B5' is not known; give A4, A3, A2, A1, A0, or WxH in mm up to 5080, as 600x400",
        ),
        ((10, 10), "0x5", "page '0x5' is not known"),
    ],
)
def test_page_too_small_is_refused_with_a_sufficient_one(needed, page, message):
    with pytest.raises(SettingsError) as error:
        choose_page(needed, page)
    assert message in str(error.value)


def test_papers_are_halves_of_each_other():
    sizes = list(PAPERS_MM.values())
    assert all(abs(large[1] / 2 - small[0]) <= 1 for small, large in pairwise(sizes))


def test_shapes_lie_on_the_page_within_its_margin():
    for board in (CHARUCO, SMALL, APRIL, CHESS, Chessboard(corners=(3, 3), square_mm=4)):
        sheet = lay_out(board).sheet
        low = np.concatenate([sheet.rectangles_mm[:, :2], *sheet.outlines_mm]).min(axis=0)
        boxes = sheet.rectangles_mm[:, :2] + sheet.rectangles_mm[:, 2:]
        high = np.concatenate([boxes, *sheet.outlines_mm]).max(axis=0)
        assert (low >= 5 - 1e-9).all() and (high <= np.array(sheet.size_mm) - 5 + 1e-9).all()


def test_image_too_large_is_refused_with_a_possible_resolution():
    sheet = lay_out(CHESS, "A0").sheet
    with pytest.raises(SettingsError, match=r"dpi 2400 makes an image of .*; give at most 508 dpi"):
        draw_sheet(sheet, 2400)
