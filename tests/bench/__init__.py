"""The numbers that the project promises.

`make bench` measures them, writes `bench.json` and prints a table with each bound; it ends with exit code 1
when one is missed; `make bench PARTS="campaign due"` measures those parts only and leaves bench.json as it
is. A part that lacks a package says so and is skipped. Every number is the median of several repetitions,
and those are in `bench.json` too. A ratio's two sides are measured in the same run, in turn. No test has a
bound on time: this is the only place that looks at a clock.
"""
