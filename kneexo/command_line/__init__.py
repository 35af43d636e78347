"""The command ``kneexo``: its parser, its commands, and the files and messages that they give."""
