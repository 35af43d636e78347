"""The mechanism beside an anatomical knee: alignment, design, fits, prosthetic leg."""
