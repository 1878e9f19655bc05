"""Tests of the benchmark: its cases, the flights, the reference results and the scores.

`test_blind.py` diagnoses a few cases in each run of the suite; `make blind` runs all of them.
"""
