"""The verbs that identify, diagnose, tune and reproduce the paper, one module each."""
