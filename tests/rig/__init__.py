"""Claims about the rigs that come with the package, and about files that cannot be a rig.

`tests/rig/test_shipped_rigs.py` tests how a file is read and spelled.
"""
