"""Claims about the import of files from other programs.

Flights whose truth is known are written as others might have: other names, units, signs, rates, delays,
motors exchanged, sums, decimal commas. The guess must be right or say that it is unsure; silently wrong is
the one thing it may not be.

`python -m tests.guess` writes 200 such files, guesses, and prints a table; `--measured` takes the measured
flights, if the shared data is available. `--exports` writes the measured flights in further forms and
counts what must be corrected in each guessed profile, with the rig file of `--rig`. `distort.py` writes a
file and keeps its truth, `students.py` writes logs of a course, `exports.py` those further forms,
`judge.py` compares, `flights.py` flies the rigs.

`python -m tests.guess.grade` writes raw files as the repositories of other courses hold them, from flights
under other controllers, and counts the corrections and the doubts that name them; `--judge` takes other
seeds. `pilots.py` flies, `foreign.py` writes.
"""
