"""The verbs of the host, one module each."""
