"""Claims about diagnosis."""
