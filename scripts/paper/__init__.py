"""The results section of the paper, measured again: studies, claims, tables, figures, a page."""
