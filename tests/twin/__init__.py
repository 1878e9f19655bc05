"""Claims about the twin, a model that runs together with a rig.

`python -m tests.twin` flies random rigs under disturbances with their twins, healthy and changed from a
moment on. It prints the tables of docs/validation/twin.md, and continues after an interruption. The tests
fly a small share. `rigs.py` draws the rigs and what a user knows of them, `changes.py` the changes,
`__main__.py` counts. `python -m tests.twin.measured` watches flights of real machines, if the shared data
is available.
"""

from tests.running.alone import one_thread_each

# Before numpy is imported: on the small matrices of the filter, more threads only wait for each other.
one_thread_each()
