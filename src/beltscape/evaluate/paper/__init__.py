"""The paper's experiments (section 3) in a rendered laboratory, compared with the paper and the truth.

`experiments` runs all of them on the captures of `laboratory`: `surfaces` reconstructs every scene,
`dimensions` measures the module, `other_sensors` measure the same belt, also the time-of-flight camera.
`page` shows the numbers that the paper published beside them, with `pictures`.
"""
