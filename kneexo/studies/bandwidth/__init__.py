"""The -3 dB bandwidth of the closed loop."""
