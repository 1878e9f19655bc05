"""Evaluation of a search: residual analysis, free runs on other flights, verdict, and what flights do not
show.
"""
