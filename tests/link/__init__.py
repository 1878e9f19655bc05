"""Claims about the link, both ends of it.

Does not belong here: whether a command is allowed in a state (`tests/flight`), whole flights (`tests/sil`).
"""
