"""Finds an encoder whose counts per turn are wrong, in one finished flight."""
