"""The logger zoo: simulated flights, written as other loggers write them, and a score of their import.

`python -m heli_benchmark zoo` draws cases from a seed, imports each as a user would, and compares the written
flights with the truth. The comparison uses no code of the importer.
"""
