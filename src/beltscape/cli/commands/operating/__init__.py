"""Commands that run a plant, and look after one that runs."""
