"""Images of a board → a rig: detect → intrinsics → pairs → network → score."""
