"""The report of ``kneexo linearize``, for its HTML page."""
