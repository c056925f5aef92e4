"""Results as pictures and as self-contained HTML pages.

`page` puts tiles, charts and tables on an offline page; `drawing` has their building blocks. Then one module or
package per subject: `calibration`, `measuring`, `planning`, `production`; single pictures; `notebook` and `viewer`.
"""
