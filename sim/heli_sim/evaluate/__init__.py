"""Numbers from symbolic expressions.

`compiled` makes C libraries of CasADi functions and keeps them. `lanes` writes C for many windows at once.
`trajectories` needs no compiler: it evaluates a function in each step of a trajectory.
"""
