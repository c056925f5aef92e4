"""Frame sets → depth: rectify, match pair by pair, fuse (the paper's Section 2.3)."""
