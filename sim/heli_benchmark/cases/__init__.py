"""The cases: a rig, what is hidden in it, and its flights; each follows from a seed."""
