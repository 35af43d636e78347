"""Studies, one package each. A study compares many scenarios and reports its findings."""
