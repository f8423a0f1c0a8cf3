"""The commands of the command line, an `execute` each."""
