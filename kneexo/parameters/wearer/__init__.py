"""The wearer: leg, cuff and strap, anatomical knee, limits of a design."""
