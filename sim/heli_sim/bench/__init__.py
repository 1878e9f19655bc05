"""Rig parameters from simple measurements with a scale, a ruler and a stopwatch."""
