"""The joining of pieces into one ledger, and their entries as bytes."""

from __future__ import annotations

import itertools
import math
from dataclasses import astuple, replace

import numpy as np
import pytest

from beltscape.core.ledger import BeltRecord, CrossSection, FlowRecord, RecordTag, SigmaParts
from beltscape.measure.flow.density import Density
from beltscape.reprocessing.history import LedgerJoiner, decode_result, encode_result, find_no_product
from beltscape.reprocessing.pieces import Overlap, Piece, PieceResult, PieceTimes, cut_into_pieces
from tests.reprocessing.recordings_made import STEP_MM, make_recording

HIGH_MM = 250.0
"""The view reaches so far upstream of a frame's position."""
OVERLAP = Overlap(700.0, 900.0)


def measure(piece: Piece, shift_mm: float = 0.0) -> list[BeltRecord]:
    """Return entries as a worker gives them: a strip of a step for each own frame."""
    entries, parts = [], SigmaParts(16.0, 1.0, 2.0, 0.5, 0.0)
    for index, placed in enumerate(piece.own):
        position = placed.frame.position_mm
        end = (index * STEP_MM if position is None else position) + HIGH_MM + shift_mm
        length = (
            2 * HIGH_MM if not piece.is_continuation and piece.previous_mm is None and not index else STEP_MM
        )
        strip = FlowRecord(
            placed.frame.frame, placed.frame.time_ns, end - HIGH_MM, (end - length, end), 100.0, 100.0 * length, 5.0,
            400.0, math.nan, 0.9, 0.8, "measured", common_sigma_mm3=3.0, sigma_parts=parts,
        )  # fmt: skip
        section = CrossSection(np.array([0, 1], np.float32), np.array([3.5, np.nan], np.float32))
        record = BeltRecord(0, 0, (end - length, end), "valid", "", 0, strip, math.nan, 2, section)
        entries.append(record)
    return entries


def join(pieces: list[Piece], **changed) -> list[BeltRecord]:
    joiner = LedgerJoiner(Density.constant(1500.0, 30.0), find_no_product)
    results = changed.get("results") or [measure(piece) for piece in pieces]
    return [
        record
        for piece, entries in zip(pieces, results, strict=True)
        for record in joiner.add(piece, entries)
    ]


def test_pieces_join_without_gap_or_overlap() -> None:
    recordings = [make_recording("a", 0, 100), make_recording("b", 100, 30)]
    whole = join(cut_into_pieces(recordings, OVERLAP, 1000))
    cut = join(cut_into_pieces(recordings, OVERLAP, 37))
    assert [record.number for record in cut] == list(range(1, 131))
    for one, other in zip(whole, cut, strict=True):
        assert one.belt_mm == other.belt_mm
        assert one.run_sigma_mm3 == other.run_sigma_mm3
    assert all(one.belt_mm[1] == two.belt_mm[0] for one, two in itertools.pairwise(cut))
    assert cut[-1].run_sigma_mm3 == pytest.approx((130 * 16 + 130**2 * (1 + 4 + 0.25)) ** 0.5)
    assert cut[0].strip is not None
    assert (cut[0].strip.density_kg_m3, cut[0].strip.density_sigma_kg_m3) == (1500.0, 30.0)


def test_a_reset_encoder_and_a_belt_without_one_go_on_with_the_lengths() -> None:
    restarted = [make_recording("a", 1000, 40), make_recording("b", 0, 40, clock_ns=10**12)]
    records = join(cut_into_pieces(restarted, OVERLAP, 1000))
    assert records[40].belt_mm == (records[39].belt_mm[1], records[39].belt_mm[1] + 2 * HIGH_MM)
    assert records[40].offset_mm != 0.0
    without = [make_recording("a", 0, 100, has_encoder=False)]
    records = join(cut_into_pieces(without, OVERLAP, 30))
    assert records[-1].belt_mm[1] - records[0].belt_mm[0] == pytest.approx(2 * HIGH_MM + 99 * STEP_MM)


def test_a_piece_that_was_not_measured_is_missing_belt() -> None:
    pieces = cut_into_pieces([make_recording("a", 0, 90)], OVERLAP, 30)
    results = [measure(pieces[0]), None, measure(pieces[2])]
    records = join(pieces, results=results)
    (gap,) = [record for record in records if record.standing == "missing"]
    assert gap.length_mm == pytest.approx(30 * STEP_MM)
    assert records[-1].belt_mm[1] == 89 * STEP_MM + HIGH_MM
    assert len(records) == 61


def test_pieces_that_disagree_are_named_and_nothing_is_counted_twice() -> None:
    pieces = cut_into_pieces([make_recording("a", 0, 60)], OVERLAP, 30)
    joiner = LedgerJoiner(Density.constant(1500.0), find_no_product)
    records = list(joiner.add(pieces[0], measure(pieces[0])))
    records += joiner.add(pieces[1], measure(pieces[1], shift_mm=-8.0))
    assert [seam.difference_mm for seam in joiner.seams] == [pytest.approx(-8.0)]
    assert all(one.belt_mm[1] == two.belt_mm[0] for one, two in itertools.pairwise(records))
    assert sum(record.length_mm for record in records) == pytest.approx(2 * HIGH_MM + 59 * STEP_MM)


def test_products_count_by_their_time() -> None:
    piece = cut_into_pieces([make_recording("a", 0, 40)], OVERLAP, 100)[0]
    half = 10**18 + piece.own[20].frame.time_ns
    coal, ore = RecordTag("coal", 800.0, 8.0), RecordTag("ore", 2000.0, 40.0)
    joiner = LedgerJoiner(Density.constant(math.nan), lambda wall_ns: ore if wall_ns >= half else coal)
    records = list(joiner.add(piece, measure(piece)))
    assert [record.product for record in records] == ["coal"] * 20 + ["ore"] * 20
    assert records[-1].mass_kg == pytest.approx(100.0 * STEP_MM * 2000e-9)


def test_entries_survive_as_bytes_to_the_last_digit() -> None:
    piece = cut_into_pieces([make_recording("a", 0, 5)], OVERLAP, 100)[0]
    entries = measure(piece)
    strip = replace(entries[0].strip, speed_mm_s=math.nan, time_ns=None, sigma_mm3=0.1 + 0.2)  # pyrefly: ignore[bad-specialization]
    entries[0] = replace(entries[0], strip=strip)
    entries[1] = replace(entries[1], strip=None, section=None, standing="missing")
    times = PieceTimes(0.1, 0.2, 0.3, 0.4, 5, 6)
    result = decode_result(encode_result(PieceResult(tuple(entries), ("a warning",), times)))
    assert result.times == times
    assert result.warnings == ("a warning",)
    for before, after in zip(entries, result.entries, strict=True):
        assert list_values(after.strip) == list_values(before.strip)
        assert after.belt_mm == before.belt_mm
        assert (after.standing, after.cameras) == (before.standing, before.cameras)
        if before.section is not None and after.section is not None:
            np.testing.assert_array_equal(after.section.height_mm, before.section.height_mm)
    assert encode_result(result) == encode_result(PieceResult(tuple(entries), ("a warning",), times))


def list_values(strip: FlowRecord | None) -> str:
    """Return all values, NaN included, as text with every digit."""
    return "" if strip is None else repr(astuple(strip))
