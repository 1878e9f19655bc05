"""The numbers that the project promises.

`make bench` measures them, writes `bench.json`, and prints each number with its bound. It exits with 1 if a
bound is missed. `make bench PARTS="campaign due"` measures these parts only, and leaves bench.json
unchanged. A part without a package that it needs is skipped with that reason.

Each number is the median of several repetitions, which are in `bench.json`, too. The two sides of a ratio
alternate in the same run. No test has a bound on time: only the bench looks at a clock.
"""
