"""Commissioning of a plant: named steps from bare cameras to a certificate, on one local page and in the terminal.

`steps` is the list: what each step needs, runs and leaves behind; `state` keeps what was answered and finished in
`commission.json`; `runner` runs a step, which is one or several of the program's own commands; `trial` is a plant of
the shipped captures; `former` sets aside what other cameras have left. `live` shows what the cameras see, or
`staged_cameras` where there are none; `optics` judges it, `guided` takes the views of the board; `material` writes
the material test; `serving` serves the page.
"""
