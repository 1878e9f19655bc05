"""Claims about the repository itself; nothing flies here.

Generated files are fresh, every public argument is documented, commands in the documents work, no path of a
build machine is in the tree, and an installation carries nothing of the tests.
"""
