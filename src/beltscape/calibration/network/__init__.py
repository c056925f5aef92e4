"""Networks of cameras: pairs, pose chains, association, global optimisation and fault isolation."""
