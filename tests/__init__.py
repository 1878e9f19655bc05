"""Claims of the project, and its measurements.

A file `test_*.py` holds claims. `make test` runs them all; each would fail if its claim were false. They are
deterministic: seeds are fixed, and no test has a bound on wall-clock time. There is one folder per subject;
its `__init__.py` says what it is. `native/` is C++: the extension `heli_test_native`, pieces of
`firmware/core` and `sim/native` for Python, which only tests use.

A test above 2 s of CPU has a marker (`slow`, `emulated`, `documents`, `diagnosis`); one above 0.1 s is
`medium`. A run lists the tests that miss theirs. `make quick` runs those without a marker. Claims about many
samples run on a share of them, and on all in `make long`. What is flown or fitted once for tests is kept
under the digest of the sources that made it.

Every other file is a helper or a measurement, and imports no test. A measurement prints numbers and has no
verdict: `python -m tests.bench` measures speed and cost, and `python -m tests.<folder>.<name>` the quality of
one subject. Helpers are next to the tests that use them.
"""
