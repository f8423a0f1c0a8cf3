"""The commands of the command line: how each is declared, and what it does."""
