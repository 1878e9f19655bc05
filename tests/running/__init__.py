"""How tests are run: plugins of pytest, which `tests/conftest.py` loads.

Does not belong here: claims about the project.
"""
