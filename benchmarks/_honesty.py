"""Honesty: is each "converged" of a random body one, and does each other lack one?"""

import math
from collections import Counter
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np

from benchmarks import _oracle
from benchmarks._bodies import KINDS, Drawn, draw
from benchmarks._problem import Figure
from softcal_jax.equilibrium import (
    RESULTS,
    EquilibriumSolution,
    NewtonSettings,
    solve_equilibrium,
)

SEED = 22
TRIED_AGAIN = 5
"""One in so many of those that did not converge is tried by the second method."""

FEWEST = 7
"""Bodies of one kind, for each of which a program is compiled."""

UNSTABLE = -1e-6
"""Scaled eigenvalue below which a state is not stable; differences are this good."""

RESIDUAL = 2.0
"""How much larger than said a residual may be, which another norm may make of it."""

CORRECTION = 1e-2
"""Share of the displacement by which Newton's next step may change it."""


class Judged(NamedTuple):
    """What the oracle says of a solution that is said to be one.

    Attributes:
        violations: What is wrong with it.
        correction: Newton's next step, as a share of the displacement [-].
    """

    violations: list[str]
    correction: float


def run(count: int, say: Callable[[str], None]) -> tuple[dict[str, Figure], list[str]]:
    """Solve and check so many bodies.

    Returns:
        The figures, and a line for each violation.
    """
    each = max(FEWEST, math.ceil(count / len(KINDS)))
    order = np.random.default_rng(SEED).permutation(len(KINDS))
    counts, lines, worst = Counter[str](), [], 0.0
    counts.update(dict.fromkeys(_COUNTED, 0))
    for i in range(count):
        kind = KINDS[order[i // each]]
        if i % each == 0:
            say(f"honesty: {i} of {count}, {' '.join(map(str, kind))}")
        drawn = draw(np.random.default_rng([SEED, i]), kind)
        solution = _solve(drawn)
        if not bool(solution.converged):
            counts["not_converged"] += 1
            if counts["not_converged"] % TRIED_AGAIN == 1:
                counts["tried_again"] += 1
                if _second_method(drawn):
                    counts["found_by_a_second_method"] += 1
                    why = RESULTS[solution.result].partition(";")[0]
                    lines.append(f"body {i} ({kind}): found, where softcal said: {why}")
            continue
        judged = judge(drawn, solution)
        counts["converged"] += 1
        counts["at_rounding"] += bool(solution.at_rounding)
        counts["off_by_1_percent"] += judged.correction > CORRECTION
        counts["violations"] += bool(judged.violations)
        worst = max(worst, judged.correction)
        lines += [f"body {i} ({kind}): {text}" for text in judged.violations]
    figures: dict[str, Figure] = {**counts, "worst_correction": worst}
    return {f"honesty_{name}": value for name, value in figures.items()}, lines


_COUNTED = (
    "violations",
    "converged",
    "at_rounding",
    "off_by_1_percent",
    "not_converged",
    "tried_again",
    "found_by_a_second_method",
)


@eqx.filter_jit
def _compiled(model, configuration, settings) -> EquilibriumSolution:
    return solve_equilibrium(model, configuration, settings=settings)


def _solve(drawn: Drawn) -> EquilibriumSolution:
    settings = NewtonSettings().as_arrays()
    return _compiled(drawn.model, drawn.configuration, settings)


def judge(drawn: Drawn, solution: EquilibriumSolution) -> Judged:
    """Check the forces, tets and stability of a solution that is said to be one."""
    body, u = drawn.body, np.asarray(solution.displacement)
    wrong = []
    if not np.isfinite(u).all():
        return Judged(["the displacement is not finite"], math.inf)
    assembly = _oracle.Assembly(body)
    now = assembly.balance(u)
    if not now.min_det_F > 0.0:
        return Judged([f"a tet is inverted: det F = {now.min_det_F:.3g}"], math.inf)
    if not np.isfinite(now.internal).all():
        return Judged(["the law has no forces at this displacement"], math.inf)
    if np.any(u[~body.free]):
        wrong.append("a support has moved")
    norm = np.linalg.norm
    g = np.where(body.free, now.internal - body.load, 0.0)
    scale = max(norm(body.load), norm(now.internal))
    said = max(1e-8, float(solution.rounding), float(solution.residual))
    allowed = RESIDUAL * said * scale + norm(now.rounding)
    if norm(g) > allowed:
        wrong.append(
            f"forces off by {norm(g) / scale:.2e} of the largest, where at most "
            f"{said:.2e} was said"
        )
    K = assembly.on_free(u)
    if int(solution.n_negative) == 0:
        lowest = _oracle.lowest_eigenvalue(K)
        if lowest < UNSTABLE:
            wrong.append(f"said to be stable, with an eigenvalue of {lowest:.2e}")
    return Judged(wrong, _correction(K, g[body.free], now.rounding, u))


def _correction(K: Any, g: np.ndarray, rounding: np.ndarray, u: np.ndarray) -> float:
    """Newton's next step beyond that of rounding, as a share of the displacement."""
    beyond = np.where(np.abs(g) > rounding.max(), g, 0.0)
    step = np.abs(_oracle.solved(K, beyond))
    return float(step.max() / max(np.abs(u).max(), 1e-300))


def _second_method(drawn: Drawn) -> bool:
    """Whether the Newton method of FElupe finds a stable equilibrium."""
    assembly = _oracle.Assembly(drawn.body)
    u = _oracle.equilibrium(assembly)
    return u is not None and _oracle.lowest_eigenvalue(assembly.on_free(u)) > -UNSTABLE
