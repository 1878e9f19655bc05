"""Format of the published benchmark: folders of cases, answers, names of causes."""

from heli_benchmark.task.answer import Answer, Estimate, answer_with, read_answer, write_answer
from heli_benchmark.task.axis_series import AxisSeries
from heli_benchmark.task.case import BenchmarkCase, read_case
from heli_benchmark.task.split import CAUSES_FILE, NOTHING, UNLISTED, Causes, Split, read_split

__all__ = [
    "CAUSES_FILE",
    "NOTHING",
    "UNLISTED",
    "Answer",
    "AxisSeries",
    "BenchmarkCase",
    "Causes",
    "Estimate",
    "Split",
    "answer_with",
    "read_answer",
    "read_case",
    "read_split",
    "write_answer",
]
