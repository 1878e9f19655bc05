"""Pages, figures and sentences of results."""
