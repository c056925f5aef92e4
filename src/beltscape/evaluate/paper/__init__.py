"""The paper's experiments (section 3) in a rendered laboratory, compared with the paper and the truth.

`experiments` runs all of them on the captures of `laboratory`: `surfaces` reconstructs every scene, `density`,
`dimensions` (with `features`), `tof` and `other_sensors` are the single experiments, `numbers` what the paper
published. `pages` shows both side by side.
"""
