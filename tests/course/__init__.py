"""The notebooks of the course run.

`test_notebooks.py`: each from its first cell to its check, twice, all in one folder. Cells tagged `long`
diagnose shorter flights, but for `make long`.
"""
