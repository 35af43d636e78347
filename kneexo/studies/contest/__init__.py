"""Controllers compared under equal conditions."""
