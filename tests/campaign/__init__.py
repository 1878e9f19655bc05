"""Campaigns: many cases, killed and continued.

Does not belong here: whether a diagnosis is right (`../diagnose`).
"""
