"""Claims about the repository itself.

That generated files are fresh, that every public argument is documented, that what the documents tell a
reader to type works, that no path of a build machine is in the tree, that an installation carries nothing
of the tests. Nothing here flies.
"""
