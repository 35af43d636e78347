"""The command ``kneexo``: arguments, files, messages and pages of reports."""
