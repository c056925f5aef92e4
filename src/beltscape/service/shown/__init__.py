"""What the page shows now, kept small: belt surface, flow, pictures, how long frames took."""
