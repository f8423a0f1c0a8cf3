"""Checks of the model against mathematics, and of runs against what they recorded."""
