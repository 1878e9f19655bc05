"""Claims about what is missing in a model.

The simulated board makes flights at 500 Hz of rigs with a known hidden effect (`hidden.py`).

Does not belong here: cases with MuJoCo (`sim/heli_benchmark/tests`).
"""
