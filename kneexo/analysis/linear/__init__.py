"""Linear models of plant and sampled loop, their poles and margins."""
