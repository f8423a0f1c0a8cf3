"""Metrics as accumulators over blocks of rows."""
