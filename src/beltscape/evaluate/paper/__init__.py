"""The paper's experiments (section 3) in a rendered laboratory, compared with the paper and the truth."""
