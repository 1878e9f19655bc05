"""Claims about the twin: a model that runs together with a rig.

`python -m tests.twin` flies random rigs in weather with their twins, healthy and changed from a moment on,
and prints the tables of docs/validation/twin.md; it goes on where it was stopped. `rigs.py` draws the rigs
and what a user knows of them, `changes.py` what changes, `__main__.py` counts. The tests fly a short share.
`python -m tests.twin.measured` (`measured.py`) flies beside real machines, where their flights are.
"""
