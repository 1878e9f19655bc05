"""Claims about control laws that come over the link.

Does not belong here: the board's own law (`tests/control`).
"""
