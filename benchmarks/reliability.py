"""What is promised of bad input, kills, wrong solutions and leaks: does it hold?

Four parts, each with a count: `malformed_inputs` go through the command line and must
be refused; `kills` end calibrations, and half as many sweeps, at random moments, which
must go on to the same results; `honesty` checks equilibria of random bodies by FElupe;
`leaks` calibrates over and over in one process. All are drawn from one seed.
`run reliability --count kills=6` does one part, and six of it.
"""

from benchmarks import _honesty, _kills, _leaks, _malformed_inputs
from benchmarks._problem import Figure, Goal, Options, Outcome

COUNTS = {"malformed_inputs": 1020, "kills": 100, "honesty": 500, "leaks": 200}
"""The parts, and how many of each are done if nothing else is asked for."""

_PARTS = {
    "malformed_inputs": _malformed_inputs.run,
    "kills": _kills.run,
    "honesty": _honesty.run,
    "leaks": _leaks.run,
}

NONE = Goal("at most", 0)

GOALS = {
    "malformed_inputs_tracebacks": NONE,
    "malformed_inputs_hangs": NONE,
    "malformed_inputs_over_4_gb": NONE,
    "malformed_inputs_accepted_silently": NONE,
    "kills_rows_lost": NONE,
    "kills_results_that_differ": NONE,
    "kills_orphans": NONE,
    "kills_refused_to_go_on": NONE,
    "honesty_violations": NONE,
    "honesty_off_by_1_percent": NONE,
    "leaks_mb_per_call": Goal("at most", 0.1),
    "leaks_more_threads": NONE,
    "leaks_more_files": NONE,
    "leaks_more_maps": NONE,
}


def run(options: Options) -> Outcome:
    """Do the parts that are asked for, or all."""
    figures: dict[str, Figure] = {}
    for part, count in (options.counts or COUNTS).items():
        counted, lines = _PARTS[part](count, options.say)
        figures |= counted
        for line in lines:
            options.say(f"did not hold: {line}")
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, goals=goals)
