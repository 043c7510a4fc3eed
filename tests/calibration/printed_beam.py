"""An anisotropic beam that tests of the loop share, so that it is compiled once."""

BEAM = {"cells": (4, 1, 1), "order": 1, "poses": (1, 5), "n_effectors": 4}
