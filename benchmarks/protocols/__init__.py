"""Load of the protocols: what each costs the service of a plant while clients read it."""
