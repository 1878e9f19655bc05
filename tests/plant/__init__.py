"""Claims about rigs, models and the compiled plant.

Witnesses are closed forms, conserved energy, numbers of the paper, and SciPy's integrator on the same
symbols; never the code of the plant. `toys.py` has rigs and effects that are simple enough for exact
solutions.
"""
