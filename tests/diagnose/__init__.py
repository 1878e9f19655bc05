"""Claims about what is missing in a model.

The simulated board makes flights at 500 Hz of rigs with a known hidden effect (`hidden.py`); `../blind`
does the same at full length on another engine, over the whole catalogue. Folders mirror the package:

Does not belong here: cases with MuJoCo (`../blind`).
"""
