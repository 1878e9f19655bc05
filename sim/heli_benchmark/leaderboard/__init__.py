"""Scores of runs, with intervals, comparisons by pairs, a table and a figure."""

from heli_benchmark.leaderboard.pool import pooled_scores, scores_content
from heli_benchmark.leaderboard.score import CaseScore, score_run, score_runs
from heli_benchmark.leaderboard.summary import summarise_runs

__all__ = ["CaseScore", "pooled_scores", "score_run", "score_runs", "scores_content", "summarise_runs"]
