"""Guess the columns, units, signs and zeros of a log from another program: names decide, physics confirms."""

from heli_lab.setup.guess.files import merge_tables
from heli_lab.setup.guess.propose import RigMatch, guess, guess_by_rigs
from heli_lab.setup.guess.result import Ambiguity, Guess, SignChoice

__all__ = ["Ambiguity", "Guess", "RigMatch", "SignChoice", "guess", "guess_by_rigs", "merge_tables"]
