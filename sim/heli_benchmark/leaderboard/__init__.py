"""Scores of runs, with intervals, comparisons by pairs, a table and a figure."""

from heli_benchmark.leaderboard.score import CaseScore, score_run, score_runs
from heli_benchmark.leaderboard.summary import summarise_runs

__all__ = ["CaseScore", "score_run", "score_runs", "summarise_runs"]
