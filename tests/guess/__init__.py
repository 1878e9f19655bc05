"""Claims about the import of files from other programs.

Flights with a known truth are written as other programs might: with other names, units, signs, rates and
delays, exchanged motors, sums, and decimal commas. The guess must be right, or say that it is unsure. It
must never be wrong without a doubt.

`python -m tests.guess` writes 200 such files, guesses, and prints a table. `--measured` uses the measured
flights, if the shared data is available. `--exports` writes them in further forms, and counts the
corrections that each guessed profile needs with the rig file of `--rig`.

`python -m tests.guess.grade` writes raw files as the repositories of other courses have them (`foreign.py`).
It counts the corrections, and the doubts that name them; `--judge` uses other seeds.
"""
