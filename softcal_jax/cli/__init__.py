"""The command line: `softcal demo`, `check`, `calibrate`, `simulate` and others.

Exit codes: 0 done, 1 not converged or no equilibrium, 2 bad input, 3 values
that must not be used, 130 interrupted by Ctrl-C or SIGTERM.
"""

from softcal_jax.cli._main import main as main
