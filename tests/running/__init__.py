"""How tests are run: plugins of pytest, which `conftest.py` loads.

Does not belong here: claims about the project.
"""
