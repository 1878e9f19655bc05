"""Claims about the prediction error method.

`made.py`: the flight, made once. `density.py`: the normal density written out.

Does not belong here: what is concluded from an estimate (`../diagnose`).
"""
