"""Claims about plants for other simulators.

FMPy, an importer that knows the standard and nothing of ours, validates the units, drives them, and
compiles their sources.
"""
