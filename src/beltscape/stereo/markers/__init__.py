"""Projected markers of the speckle pattern (the paper's Section 2.1): detection, numbering, regions."""
