"""Several cameras: pairs, pose chains, association, global optimisation, and faults found on the way."""
