"""The command ``kneexo``: its parser, its subcommands, and their files and messages."""
