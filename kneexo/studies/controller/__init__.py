"""The settings of the sliding mode controller."""
