"""Comparison of two histories of the same belt: two re-processings, or a plant's own history and a re-processing.

`reading` opens a history without a lock and without a trace; `alignment` lays both along the belt by the frames that
both have; `segments` cuts the belt where either has an edge; `uncertainty` sums with σ of each and of the difference;
`comparison` joins these with `intervals`, `stretches`, `reasons`, `identity`, `provenance` and `pattern`;
`presentation` gives the terminal summary, the JSON document and the page.
"""
