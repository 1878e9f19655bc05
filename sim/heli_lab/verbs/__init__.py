"""Verbs of the laboratory: each reads options, calls one function of its package, and prints."""
