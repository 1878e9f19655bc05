"""Practice and field cases, whose truth is known.

Eleven clean cases and ten in weather that lie beside the project, in `../shared/data/practice` and
`../shared/data/field`: two simulated flights each, and a `truth.toml` that says what is hidden. Other cases
of the kind judge this project; these are for looking.

`python -m tests.field` asks the diagnosis, which gets the flights and nothing else, and prints a table:
what is hidden, the verdict, the causes with confidence and numbers, whether that is right, and the seconds
of CPU. `python -m tests.field 'lag*'` asks some; `--json` keeps the answers. `cases.py` reads the cases and
judges, `__main__.py` asks and prints. `golden.py` compares the diagnosis of every practice, field and
measured case with the results in `golden.json`: a change of names or structure must not change them.

Without that folder it says `skipped: no shared data`, and so do the tests. No row of a flight belongs here.
"""
