"""The prepared frame, the context that all stages share, and the surface on the matcher's grid."""
