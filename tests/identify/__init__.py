"""Claims about fits.

Rigs with known parameters fly on the simulated board (`made.py`), and the fit must find these parameters.
It must explain simulated flights down to the quantisation. `tests/measured` fits flights of real machines.
"""
