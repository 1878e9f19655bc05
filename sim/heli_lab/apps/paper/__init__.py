"""Reproduce the bench tests, tables and figures of the paper on the simulated rig; see `heli-host paper`.

The paper is by Makki, Moosapour, Mobayen and Nobari. Numbers of equations, tables and figures are those of
the paper. The page docs/validation/paper.md states which results agree. The equations as printed are the
model `paper_printed` of heli_sim.
"""
