"""Claims about the twin, a model that runs together with a rig.

`python -m tests.twin` flies random simulated rigs, unchanged and with a change, and prints the tables of
docs/validation/twin.md. The tests fly a small share of these flights. `python -m tests.twin.measured`
monitors flights of real machines, if the shared data is available.
"""

from tests.running.alone import one_thread_each

# Before numpy is imported. On the small matrices of the filter, several threads only wait for each other.
one_thread_each()
