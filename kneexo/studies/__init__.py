"""Studies: each compares many scenarios.

The module of a study has its settings and its result; ``…_report`` the text, ``…_figures`` the
pictures.
"""
