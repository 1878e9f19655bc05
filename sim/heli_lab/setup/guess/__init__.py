"""Guess the columns, units, signs and zeros of a log from another program, from names and physics."""

from heli_lab.setup.guess.merge import merge_tables
from heli_lab.setup.guess.result import Ambiguity, Guess, SignChoice
from heli_lab.setup.guess.rigs import RigMatch, guess_by_rigs
from heli_lab.setup.guess.run import guess

__all__ = ["Ambiguity", "Guess", "RigMatch", "SignChoice", "guess", "guess_by_rigs", "merge_tables"]
