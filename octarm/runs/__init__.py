"""A run on disk, and all that it depends on."""
