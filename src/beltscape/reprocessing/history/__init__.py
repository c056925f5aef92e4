"""One history from the results of all pieces: a ledger, its totals and its products.

`entries_file` keeps the results of a piece; `joining` drops what two pieces both measured; `products` takes the
products from the plant's own history; `history` writes the ledger.
"""
