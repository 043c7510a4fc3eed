"""`python -m softcal_jax` is the command `softcal`."""

import sys

from softcal_jax.cli import main

if __name__ == "__main__":
    sys.exit(main())
