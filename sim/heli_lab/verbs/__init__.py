"""The verbs that identify, diagnose, tune and do the paper again, one module each."""
