"""Reproduce the paper's bench tests, tables and figures on the simulated rig."""
