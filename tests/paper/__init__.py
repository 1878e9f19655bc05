"""Claims about the project's account of the paper.

The equations as printed, bench tests on a locked rig, the two readings of Table 6, and the figures. Every
number in docs/validation/paper.md is what the commands print today.
"""
