"""How tests are run.

Plugins of pytest, loaded by `tests/conftest.py`. Does not belong here: claims about the project.
"""
