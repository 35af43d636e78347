"""What a better motor, pump or encoder buys."""
