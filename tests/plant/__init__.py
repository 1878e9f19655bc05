"""Claims about rigs, models and the compiled plant.

Witnesses: closed forms, conserved energy, the numbers of the paper, and scipy's integrator on the same
symbols; never the plant's own code. `toys.py` holds rigs and effects simple enough to have exact solutions.
"""
