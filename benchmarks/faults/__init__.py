"""The bench of faults: each begins in the middle of a recording with exact truth, in front of the running system."""
