"""Grids of axes."""

class GridSpec:
    nrows: int
    ncols: int

class SubplotSpec:
    rowspan: range
    colspan: range
    def get_gridspec(self) -> GridSpec: ...
