"""The environment for learning.

Gymnasium's own checker is the witness of the interface, `Plant.step` of the physics, the board in lockstep
of the plant alone.
"""
