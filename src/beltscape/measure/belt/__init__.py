"""The empty belt: its frame, cross-section, ends and edges, learned from depth maps."""
