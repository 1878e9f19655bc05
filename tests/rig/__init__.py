"""Claims about the rigs that come with the package.

Claims about the rigs that come with the package, and about files that cannot be a rig. Reading and spelling
of a file are tested in `tests/plant/test_rig.py`.
"""
