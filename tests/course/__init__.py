"""The notebooks of the course run.

`test_notebooks.py` runs each notebook from its first cell to its check, twice, all in one folder. Cells
with the tag `long` diagnose shorter flights, except in `make long`.
"""
