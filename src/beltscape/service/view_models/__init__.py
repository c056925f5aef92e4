"""View models of the page, in bounded memory: belt surface, flow, pictures, processing times."""
