"""Evaluation of results against ground truth: scores, simulated truth, the paper's experiments, real pairs, the demo."""
