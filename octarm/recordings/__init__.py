"""What people look at: recordings, the viewer, figures, films."""
