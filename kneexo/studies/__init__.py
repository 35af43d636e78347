"""Studies: each compares many scenarios and reports its findings."""
