"""Holes in the fused belt: σ and depth of cells that several frames did not measure."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from beltscape.core.height_map import HeightMap, coarsen
from beltscape.measure.belt.reference import Layer
from beltscape.measure.flow import rows
from beltscape.measure.flow.blocks import BeltPiece
from beltscape.measure.flow.fuse import fuse
from beltscape.measure.flow.rows import BeltPicture, RowFiller
from beltscape.measure.flow.settings import FlowSettings
from tests.measure.flow.moving_belt import make_empty_belt

GROUND = make_empty_belt()


def filled(height_mm: NDArray[np.float32], frames: int) -> NDArray[np.float32]:
    """The belt made of so many frames alike."""
    pieces: list[BeltPiece] = []
    filler = RowFiller(make_empty_belt(), FlowSettings(), pieces.append)
    sigma = np.where(np.isfinite(height_mm), np.float32(0.1), np.float32(np.nan))
    share = np.isfinite(height_mm).mean(axis=1)
    layer = Layer(0, height_mm, sigma, sigma, share, np.zeros(len(share)))
    for pending in [*filler.add(fuse([layer] * frames, 0, len(height_mm))), *filler.close()]:
        pending.finish()
    return np.concatenate([piece.height_mm for piece in pieces])


def bumps(level_mm: float) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """A rough load with a hole, on the meter's own columns."""
    columns = make_empty_belt().grid.shape[1]
    noise = 8 * np.random.default_rng(0).standard_normal((40, columns))
    height = (level_mm + np.abs(noise)).astype(np.float32)
    hole = np.zeros(height.shape, bool)
    hole[15:25, 30:45] = True
    height[hole] = np.nan
    return height, hole


def test_holes_missing_in_several_frames_are_filled_lower() -> None:
    height, hole = bumps(60.0)
    one, two, many = (filled(height, frames)[hole].mean() for frames in (1, 2, 6))
    assert many < two < one
    np.testing.assert_allclose(one - two, 0.6 * (one - many), rtol=1e-3)  # 1 - 1/2 of 1 - 1/6


def test_holes_are_not_lowered_below_the_belt() -> None:
    height, hole = bumps(0.0)
    assert (filled(height, 12)[hole] >= np.minimum(filled(height, 1)[hole], 0)).all()


def test_rows_beside_a_gap_that_show_only_the_belts_sides_are_not_counted() -> None:
    """Of a tall load the image's edge shows the bare sides only: no cross-section ends there."""
    columns = make_empty_belt().grid.shape[1]
    height = np.full((120, columns), 80.0, np.float32)
    height[:, :8] = height[:, -8:] = 0
    bare = height.copy()
    bare[:, 8:-8] = np.nan
    filler, rows = RowFiller(make_empty_belt(), FlowSettings(), None), []
    gap = round(FlowSettings().margin_mm / make_empty_belt().cell_mm) + 10
    before = np.concatenate([height, bare[:6]])
    after = np.concatenate([bare[:6], height])
    for first, part in ((0, before), (len(before) + gap, after)):
        seen = np.isfinite(part)
        sigma = np.where(seen, np.float32(0.1), np.float32(np.nan))
        layer = Layer(first, part, sigma, sigma, seen.mean(axis=1), np.zeros(len(part)))
        rows += filler.add(fuse([layer], first, first + len(part)))
    rows = [pending.finish() for pending in (*rows, *filler.close())]
    full = make_empty_belt().cell_mm * height[0].sum()
    counted = np.concatenate([row.first + np.arange(len(row)) for row in rows])
    np.testing.assert_array_equal(
        counted, [*range(120), *range(len(before) + gap + 6, len(before) + gap + 126)]
    )
    np.testing.assert_allclose(np.concatenate([row.area_mm2 for row in rows]), full, rtol=1e-6)


def add_pieces(picture: BeltPicture, seed: int = 0, pieces: int = 4) -> BeltPicture:
    """Add random pieces of 37 rows, from a negative row on."""
    rng, columns = np.random.default_rng(seed), GROUND.grid.shape[1]
    for first in range(-50, -50 + 37 * pieces, 37):
        height = rng.normal(50, 10, (37, columns)).astype(np.float32)
        sigma = rng.uniform(0.1, 1, height.shape).astype(np.float32)
        picture.add(BeltPiece(first, height, sigma, rng.uniform(size=height.shape) < 0.8))
    return picture


def compare_maps(
    one: tuple[HeightMap, NDArray[np.float64]], two: tuple[HeightMap, NDArray[np.float64]]
) -> None:
    for name in ("height_mm", "sigma_mm"):
        np.testing.assert_allclose(getattr(one[0], name), getattr(two[0], name), rtol=1e-12)
    np.testing.assert_allclose(one[1], two[1], rtol=1e-12)
    assert one[0].origin_mm == pytest.approx(two[0].origin_mm)
    assert one[0].cell_mm == pytest.approx(two[0].cell_mm)


def test_the_picture_has_the_finest_cells_until_there_are_too_many(monkeypatch: pytest.MonkeyPatch) -> None:
    fine = add_pieces(BeltPicture(GROUND)).height_map()
    assert fine[0].cell_mm == GROUND.cell_mm
    monkeypatch.setattr(rows, "PICTURE_CELL_MM", 3 * GROUND.cell_mm)
    monkeypatch.setattr(rows, "_MOST_CELLS", fine[0].height_mm.size // 7)
    picture = add_pieces(BeltPicture(GROUND))
    assert not picture.is_shortened
    compare_maps(picture.height_map(), add_pieces(BeltPicture(GROUND, 4 * GROUND.cell_mm)).height_map())
    monkeypatch.setattr(rows, "_MOST_CELLS", fine[0].height_mm.size // 40)
    shortened = add_pieces(BeltPicture(GROUND))
    assert shortened.is_shortened
    assert shortened.cell_mm == picture.cell_mm


@pytest.mark.parametrize("side", [2, 3, 5])
def test_cells_of_a_fine_picture_average_to_those_of_a_coarse_one(side: int) -> None:
    fine = add_pieces(BeltPicture(GROUND)).height_map()
    coarse = add_pieces(BeltPicture(GROUND, side * GROUND.cell_mm)).height_map()
    compare_maps(coarsen(*fine, side * GROUND.cell_mm), coarse)
