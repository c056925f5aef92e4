"""Window sizes grow with the images and stay within the limits of the kernels."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from beltscape.kernels.arrays import WINDOW_LIMIT
from beltscape.kernels.least_squares import fit_windows
from beltscape.stereo.multiview.frame import choose_windows

widths = st.integers(1, 20_000)


@given(widths)
def test_windows_are_accepted_by_the_kernels(width_px):
    size = choose_windows(width_px)
    for radii in (size.narrow, size.firm, size.wide):
        assert fit_windows(radii)
    assert size.narrow[-1] < size.firm[-1] < size.wide[-1] or size.firm[-1][0] == WINDOW_LIMIT
    assert 1 <= size.levels_px <= WINDOW_LIMIT


@given(widths, widths)
def test_windows_do_not_shrink_with_the_grids_width(a, b):
    small, large = choose_windows(min(a, b)), choose_windows(max(a, b))
    assert small.scale <= large.scale
    assert small.levels_px <= large.levels_px
    for name in ("narrow", "firm", "wide"):
        assert all(s <= w for s, w in zip(getattr(small, name), getattr(large, name), strict=True))
