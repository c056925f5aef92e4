"""Evaluation against ground truth: scores, simulated truth, the paper's experiments, real pairs and the demo."""
