"""Claims about the prediction error method.

`pendulum.py`: the normal density written out, flights, and a machine that is no helicopter.

Does not belong here: what is concluded from an estimate (`../diagnose`).
"""
