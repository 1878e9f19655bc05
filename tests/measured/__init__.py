"""Claims about flights of real machines.

Four pairs of flights of Quanser-type machines, in `../shared/data/measured`; no licence is stated by their
repositories, so none of them is in this one, and what runs here needs that folder. Tests say `skipped: no
shared data` without it.

`python -m tests.measured` fits each pair's first flight, predicts the second two seconds ahead, prints the
tables of docs/validation/measured-flights.md and draws its figures into `docs/figures/`; `--diagnose` lets
the search name the causes instead of being told them. `pairs.py` has the pairs and the fits, `figures.py`
the drawings, `__main__.py` the tables.

Only numbers and small figures that were computed from the flights belong here, never rows of them.
"""
