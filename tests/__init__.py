"""Claims of the project.

`make test` runs them all; each reads as a claim and would fail if the claim were false. Deterministic:
seeds are fixed, and nothing here has a bound on wall-clock time (`bench/` measures, and is no test). One
folder per subject; its `__init__.py` says what it is. `native/` is C++: the extension `heli_test_native`,
pieces of `firmware/core` and `sim/native` for Python, which only tests use.

A test above 2 s of CPU says so by a marker (`slow`, `emulated`, `documents`, `diagnosis`) or fails the run;
one above 0.1 s is `medium`, and above 1 s it must be. `make quick` runs those without a marker. Claims
about many samples run on a share of them, and on all in `make long`. What is flown or fitted once for tests
is kept under the digest of the sources that made it.

Helpers are next to the tests that use them, and are imported as `tests.<room>.<name>`.

`mujoco_rig.py` draws the rig in MuJoCo for every folder that compares equations with it.
"""
