"""Claims about flights of real machines.

Four pairs of flights of Quanser-type machines are in `../shared/data/measured`. Their repositories state no
licence, so that no row of them is copied; only numbers and small figures computed from them are. Without
that folder, tests say `skipped: no shared data`.

`python -m tests.measured` fits the first flight of each pair, and predicts the second two seconds ahead. It
prints the tables of docs/validation/measured-flights.md, and draws its figures into `docs/figures`. The
models have given effects; with `--diagnose`, the search names the causes. `pairs.py` has the pairs and
fits, `figures.py` the drawings, `__main__.py` the tables.
"""
