"""Networks whose weights were fitted to simulated captures with exact truth.

`registry` names every network, what it predicts and what it must not be used for, and loads it. `network`
holds a network's features, their limits and its layers, evaluates it by the kernels, and reads and writes it.
docs/reference/models.md is the card of each network; ``make train`` fits all of them again.
"""
