"""Gains by the same search, objective and budget for every controller."""
