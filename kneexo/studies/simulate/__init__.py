"""The report of ``kneexo simulate``, for its HTML page."""
