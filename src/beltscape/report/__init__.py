"""Results as pictures and as self-contained HTML pages.

`page` puts tiles, charts and tables on an offline page; `drawing` has their building blocks. Then one module
or package per subject: `calibration` with `calibration_plots`, `plan` with `plan_drawing`, `measuring`,
`production`; single pictures of `blue_noise` and `control_pictures`; `notebook` and `viewer`.
"""
