"""The types that all packages share: cameras, rigs, poses, frames, depth maps, belts, records. Imports numpy only."""
