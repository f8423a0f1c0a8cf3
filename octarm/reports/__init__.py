"""What a finished sweep says: tables, figures, a page."""
