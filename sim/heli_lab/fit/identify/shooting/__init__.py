"""Multiple shooting: the solution of an estimation problem over windows with free initial states."""

from heli_lab.fit.identify.shooting.solve import solve

__all__ = ["solve"]
