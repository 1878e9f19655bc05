"""Other systems than this one.

No Windows and no macOS is here: `without/sitecustomize.py` hides what Windows lacks from every process that
finds it on its path, and `test_hidden.py` flies without. What that cannot show, docs/how-to/platforms.md
calls untested.
"""
