"""A run in time: metrics, verdict, notices, energy, stops and pushes."""
