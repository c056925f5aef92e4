"""The paper's experiments, section 3, in a rendered laboratory: its numbers, ours, and the truth."""
