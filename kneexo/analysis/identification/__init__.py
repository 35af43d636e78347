"""Finds numbers of a scenario: from a log (`fit.fit`), by a designed motion (`experiment`)."""
