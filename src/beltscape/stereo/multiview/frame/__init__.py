"""One frame on the matcher's grid: grey levels, projections, surfaces, and the small tools that all stages use."""
