"""Practice and field cases, whose truth is known.

Eleven clean cases are in `../shared/data/practice`, and ten with disturbances in `../shared/data/field`.
Each has two simulated flights, and a `truth.toml` that names the hidden causes. These cases are for
development; others of their kind judge this project.

`python -m tests.field` diagnoses them from the flights alone, and prints a table: hidden causes, verdict,
causes with confidence and sizes, whether that is right, and CPU time. `python -m tests.field 'lag*'`
diagnoses some of them; `--json` saves the answers. `golden.py` compares the diagnosis of every practice,
field and measured case with `golden.json`. A change of names or structure must not change these results.

Without the shared data, the command and the tests say `skipped: no shared data`. No row of a flight is
copied.
"""
