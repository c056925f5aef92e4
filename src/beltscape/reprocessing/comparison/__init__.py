"""Comparison of two histories of the same belt.

They are two re-processings, or a plant's own history and a re-processing. `ledger` opens a history without a
lock and without a trace; `segments` lays both along the belt by the frames that both have, and cuts the belt
where either has an edge; `uncertainty` sums with σ of each and of the difference; `differences` says where
and how they differ; `comparison` joins these. `texts` gives the terminal summary, `document` the JSON
document, `page` the page.
"""
