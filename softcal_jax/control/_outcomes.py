"""Outcomes of a command, with their messages."""

import equinox as eqx


class OUTCOMES(eqx.Enumeration):
    """Outcome of inverse control, compared with `==`."""

    met = "all goals are met"
    nearest = (
        "nearest reachable point: some goals are not met, and no step within the "
        "limits comes closer"
    )
    limits_violated = (
        "no actuation near the start keeps the limits of what follows the actuators; "
        "start inside them, or widen them"
    )
    stalled = (
        "steps were refused until none was left, short of a minimum; the equilibria "
        "may jump there (buckling), or newton.rtol be too coarse"
    )
    max_steps = "the search did not end within max_steps; raise it"
    no_equilibrium = "the start has no equilibrium; start from another actuation"
