"""Treloar's measurements of vulcanised rubber, and published fits to them.

L. R. G. Treloar, "Stress-strain data for vulcanised rubber under various types of
deformation", Trans. Faraday Soc. 40, 59-70 (1944), 8 % sulphur rubber at 20 C, as
tabulated by P. Steinmann, M. Hossain and G. Possart, "Hyperelastic models for
rubber-like materials: consistent tangent operators and suitability for Treloar's data",
Arch. Appl. Mech. 82, 1183-1217 (2012), and distributed with simcoon (github.com/3MAH/
simcoon, examples/hyperelasticity/comparison/Treloar.txt).
"""

from typing import NamedTuple

import numpy as np

from softcal_jax._typing import Float, HostArray


class Test(NamedTuple):
    """One kind of test: stretch [-] and nominal stress [Pa]."""

    stretch: Float[HostArray, " n"]
    stress: Float[HostArray, " n"]


def _test(*pairs: float) -> Test:
    stretch, stress = np.reshape(pairs, (-1, 2)).T
    return Test(stretch, 1e6 * stress)


TRELOAR = {
    "uniaxial": _test(
        *(1.01, 0.03, 1.12, 0.14, 1.24, 0.23, 1.39, 0.32, 1.61, 0.41, 1.89, 0.50),
        *(2.17, 0.58, 2.42, 0.67, 3.01, 0.85, 3.58, 1.04, 4.03, 1.21, 4.76, 1.58),
        *(5.36, 1.94, 5.76, 2.29, 6.16, 2.67, 6.40, 3.02, 6.62, 3.39, 6.87, 3.75),
        *(7.05, 4.12, 7.16, 4.47, 7.27, 4.85, 7.43, 5.21, 7.50, 5.57, 7.61, 6.30),
    ),
    "pure shear": _test(
        *(1.06, 0.07, 1.14, 0.16, 1.21, 0.24, 1.32, 0.33, 1.46, 0.42, 1.87, 0.59),
        *(2.40, 0.76, 2.98, 0.93, 3.48, 1.11, 3.96, 1.28, 4.36, 1.46, 4.69, 1.62),
        *(4.96, 1.79),
    ),
    "equibiaxial": _test(
        *(1.04, 0.09, 1.08, 0.16, 1.12, 0.24, 1.14, 0.26, 1.20, 0.33, 1.31, 0.44),
        *(1.42, 0.51, 1.69, 0.65, 1.94, 0.77, 2.49, 0.96, 3.03, 1.24, 3.43, 1.45),
        *(3.75, 1.72, 4.03, 1.96, 4.26, 2.22, 4.44, 2.43),
    ),
}
"""Stretch and nominal stress by the kind of test."""

KGF_PER_CM2 = 98066.5
"""Unit of Ogden's constants [Pa]."""

OGDEN_1972 = {
    "mu_1": 6.3 * KGF_PER_CM2,
    "alpha_1": 1.3,
    "mu_2": 0.012 * KGF_PER_CM2,
    "alpha_2": 5.0,
    "mu_3": -0.1 * KGF_PER_CM2,
    "alpha_3": -2.0,
}
"""Fit to all three tests: R. W. Ogden, Proc. R. Soc. London A 326, 565-584 (1972)."""

MOONEY_RIVLIN_2012 = {
    "uniaxial": {"c10": 0.2588e6, "c01": -0.0449e6},
    "pure shear": {"c10": 0.2348e6, "c01": -0.0650e6},
    "equibiaxial": {"c10": 0.1713e6, "c01": 0.0047e6},
}
"""Fits to one test each, Steinmann, Hossain and Possart (2012) [Pa]."""
