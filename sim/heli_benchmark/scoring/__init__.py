"""Answers against the truth: rows, goals, calibration, and tables for people."""
