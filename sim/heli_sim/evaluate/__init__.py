"""Numbers from symbolic expressions.

`compiled` makes C libraries of CasADi functions and keeps them. `lanes` writes C that steps many windows
together. `trajectories` needs no compiler: it evaluates a function in each step of a trajectory.
"""
