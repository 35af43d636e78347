"""The reduced-order against the full-order plant."""
