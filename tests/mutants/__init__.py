"""Do the tests notice a small mistake in the flight code?

The command makes one small change in a source of ``firmware/core``, compiles what depends on that source, and
runs the tests that reach the line. A change that no test notices is a survivor: a test is missing, or the
change makes no difference.

Entry point: ``make mutants``, or ``python -m tests.mutants --help``. ``declared.toml`` lists changes that
make no difference, each with its reason. ``killed.json`` lists mutants that a test killed; the suite repeats
ten of them. ``python -m tests.mutants --record`` adds to it. ``mistakes.toml`` lists mistakes that people
chose, most of them in the drivers, with the test that must notice each.
``python -m tests.mutants --mistakes 0`` runs all of them.

Does not belong here: tests of the flight code.
"""
