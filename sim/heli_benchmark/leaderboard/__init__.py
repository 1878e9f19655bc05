"""Scores of runs, with intervals, comparisons by pairs, a table and a figure."""

from heli_benchmark.leaderboard.score import CaseScore, score_run
from heli_benchmark.leaderboard.summary import summarise_runs

__all__ = ["CaseScore", "score_run", "summarise_runs"]
