"""Singular values and condition numbers of the compliances (paper Sec. V-C)."""

import numpy as np

from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray


class Conditioning(Module):
    """How evenly the data see the parameters.

    Attributes:
        singular_values: Singular values of the noise-weighted W_ep, descending; 0 where
            there are fewer data than parameters [-].
        directions: Right singular vectors V as columns: directions of lambda_p. The
            last ones are what the data see least (the paper says U, which holds
            effector directions).
        condition_weighted: Condition number of the noise-weighted W_ep [-].
        condition_W_ep: Condition number of W_ep in metres; nan if not given [-].
        condition_W_ep_W_pp: Condition number of W_ep W_pp^-1 in metres per joule, as in
            Table I; nan if not given [-].
    """

    singular_values: Float[HostArray, " n_p"]
    directions: Float[HostArray, "n_p n_p"]
    condition_weighted: float
    condition_W_ep: float
    condition_W_ep_W_pp: float

    def __str__(self) -> str:
        """Condition numbers and singular values, in two lines."""
        numbers = {
            "W_ep in noise units": self.condition_weighted,
            "W_ep": self.condition_W_ep,
            "W_ep W_pp^-1": self.condition_W_ep_W_pp,
        }
        shown = [f"{k} {v:.3g}" for k, v in numbers.items() if not np.isnan(v)]
        values = " ".join(f"{s:.3g}" for s in self.singular_values)
        return f"Condition: {', '.join(shown)}.\nSingular values: {values}."


def conditioning(
    W: Float[HostArray, "n_e n_p"],
    *,
    W_ep: Float[HostArray, "n_e n_p"] | None = None,
    W_pp: Float[HostArray, "n_p n_p"] | None = None,
) -> Conditioning:
    """Compute the SVD W = U Sigma V^T and condition numbers; Sec. V-C.

    Statistics need W in units of the noise. The paper gives the numbers of W_ep and
    W_ep W_pp^-1 with W_ep in metres, which depend on the scaling S of the parameters.
    The paper does not say how W_pp is stacked over configurations: here it is the sum
    of H_p K_c^-1 H_p^T, since all configurations share lambda_p and energies add up.

    Args:
        W: Compliances stacked over configurations, in units of the noise [-].
        W_ep: The same in metres [m].
        W_pp: Sum over configurations of H_p K_c^-1 H_p^T [J].

    Returns:
        The decomposition. A condition number is infinite where a singular value is zero
        (to rounding): fewer data than parameters, or a blind direction.
    """
    if not np.all(np.isfinite(W)):
        raise ValueError(
            "W_ep has entries that are not finite: a configuration had no equilibrium."
        )
    _, singular, Vt = np.linalg.svd(W)
    peak = np.argmax(np.abs(Vt), axis=1)
    signs = np.sign(Vt[np.arange(len(Vt)), peak])
    return Conditioning(
        singular_values=np.pad(singular, (0, W.shape[1] - len(singular))),
        directions=(signs[:, None] * Vt).T,
        condition_weighted=_condition(W),
        condition_W_ep=np.nan if W_ep is None else _condition(W_ep),
        condition_W_ep_W_pp=_condition_per_joule(W_ep, W_pp),
    )


def _condition(W: Float[HostArray, "n_e n_p"]) -> float:
    """Divide the largest by the smallest singular value; infinite below full rank."""
    singular = np.linalg.svd(W, compute_uv=False)
    rounding = max(W.shape) * np.finfo(float).eps
    if len(singular) < W.shape[1] or singular[-1] <= rounding * singular[0]:
        return np.inf
    return float(singular[0] / singular[-1])


def _condition_per_joule(
    W_ep: Float[HostArray, "n_e n_p"] | None, W_pp: Float[HostArray, "n_p n_p"] | None
) -> float:
    """Compute the condition number of W_ep W_pp^-1; infinite for a singular W_pp."""
    if W_ep is None or W_pp is None:
        return np.nan
    size = np.sqrt(np.maximum(np.diag(W_pp), 0.0))
    if not np.all(size > 0.0):
        return np.inf
    # Scale to a unit diagonal, so that a small scale does not look like blindness.
    unit = W_pp / np.outer(size, size)
    if np.linalg.eigvalsh(unit)[0] <= len(size) * np.finfo(float).eps:
        return np.inf
    return _condition(np.linalg.solve(unit, (W_ep / size).T).T / size)
