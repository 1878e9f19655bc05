"""Other systems than Linux.

No Windows and no macOS is available here. `without/sitecustomize.py` hides what Windows lacks from every
process that finds it on its path, and `test_hidden.py` flies without. docs/how-to/platforms.md lists what
remains untested.
"""
