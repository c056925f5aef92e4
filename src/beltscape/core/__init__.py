"""The vocabulary: what every room speaks of. Imports numpy only."""
