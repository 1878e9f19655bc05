"""Claims about the paper.

Claims about what the project says of the paper: its equations as printed, its bench tests on a locked rig,
Table 6's two readings, the figures, and that every number in docs/validation/paper.md is what the commands
print today.
"""
