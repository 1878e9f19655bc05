"""What a file of somebody else's means: columns, units, signs and zeros, from names and physics."""

from heli_lab.guess.result import Ambiguity, Choice, Guess
from heli_lab.guess.rigs import RigMatch, guess_by_rigs
from heli_lab.guess.run import guess
from heli_lab.guess.together import together

__all__ = ["Ambiguity", "Choice", "Guess", "RigMatch", "guess", "guess_by_rigs", "together"]
