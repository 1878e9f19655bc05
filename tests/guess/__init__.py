"""Claims about the import of files from other programs.

Flights with a known truth are written as other programs might: with other names, units, signs, rates and
delays, exchanged motors, sums, and decimal commas. The guess must be right, or say that it is unsure. It
must never be wrong without a doubt.

`python -m tests.guess` writes 200 such files, guesses, and prints a table. `--measured` uses the measured
flights, if the shared data is available. `--exports` writes them in further forms, and counts the
corrections that each guessed profile needs with the rig file of `--rig`.

`python -m tests.guess.grade` writes raw files as the repositories of other courses have them. It counts the
corrections, and the doubts that name them; `--judge` uses other seeds.

| file | content |
|---|---|
| `flights.py`, `pilots.py` | flights under our controller, and under others |
| `distort.py`, `students.py`, `exports.py`, `foreign.py` | writers of files, with their truth |
| `judge.py` | comparison of a guess with the truth |
"""
