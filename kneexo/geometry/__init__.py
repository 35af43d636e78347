"""Four-bar mathematics without Drake: linkage, rod and its inverse, motion of the shank."""
