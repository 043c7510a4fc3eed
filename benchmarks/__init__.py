"""Benchmarks: one driver, one problem per file, results as JSON.

`python -m benchmarks list` names the problems and `python -m benchmarks run NAME` runs
one. A problem is a public module of this package: the first line of its docstring says
what it measures, and `run(options)` returns an `Outcome`. A new file is a new problem.
"""
