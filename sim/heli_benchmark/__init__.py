"""A benchmark of hidden causes: flights with something hidden in them, and a score for a diagnosis of them.

A rig in MuJoCo, which does not use the equations of this project, flies with one or more effects, with an
unlisted equation, or with nothing hidden. `python -m heli_benchmark` flies each case, diagnoses its flights,
and compares the answers with the truth.
"""
