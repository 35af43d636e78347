"""What faults do: which a scenario survives, and thresholds of detectors."""
