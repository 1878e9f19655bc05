"""What a file of somebody else's means: columns, units, signs and zeros, from names and physics."""

from heli_lab.guess.result import Choice, Doubt, Guess
from heli_lab.guess.rigs import Fitting, guess_by_rigs
from heli_lab.guess.run import guess
from heli_lab.guess.together import together

__all__ = ["Choice", "Doubt", "Fitting", "Guess", "guess", "guess_by_rigs", "together"]
