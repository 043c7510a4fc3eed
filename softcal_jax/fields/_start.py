"""Before a calibration: parameters must fit the model, and where to start."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np

from softcal_jax._limits import TRIALS
from softcal_jax._names import check_known
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields._parameters import find_field, region_tets
from softcal_jax.fields._setup import SetupParameter
from softcal_jax.fields._space import ParameterSpace

SEVERAL = 6
"""Most starts by default where there may be several optima."""

# One row at a time, so that the program does not depend on the number of rows.
_to_scaled = eqx.filter_jit(lambda space, p: space.admissible(space.to_scaled(p)))


def check_parameters(
    model: Any, space: ParameterSpace, configuration: Any = None
) -> None:
    """Raise unless every parameter sets something of its own, within sound bounds.

    The model is on the host; what is set in a configuration is checked if one is given.

    Raises:
        ValueError: If a field or region does not exist, two parameters set the same
            tets, a parameter without region would flatten constants that differ over
            the body, a control point lies far from what it acts on or acts on no tet,
            the start breaks the order, or a bound is outside the range of the material.
    """
    for entry in space.entries:
        entry.check(model)
    _check_overlaps(model, space)
    _check_twice(space)
    _check_effects(model, space, configuration)
    _check_order(space)
    for side in ("lower", "upper"):
        bounds = {q.name: getattr(q, side) for q in space.parameters}
        applied, _ = space.with_values(model, None, bounds)
        try:
            _check_constants(applied.law)
            if not np.all(np.asarray(applied.density) >= 0.0):
                raise ValueError("density must not be negative [kg/m3].")
        except ValueError as error:
            what = f"with all parameters at their {side} bound"
            raise ValueError(f"{what}: {error}") from error


def _check_overlaps(model: Any, space: ParameterSpace) -> None:
    """Raise if two entries set a field of the same tet."""
    owners: dict[str, HostArray] = {}
    for i, entry in enumerate(space.entries):
        for field in entry.fields:
            find_field(model, field)
            owner = owners.setdefault(field, np.full(model.mesh.n_tets, -1))
            tets = region_tets(model.mesh, entry.tet_group)
            taken = tets[owner[tets] >= 0]
            if taken.size:
                other = space.entries[owner[taken[0]]]
                raise ValueError(
                    f"parameters {other.label!r} and {entry.label!r} both set {field} "
                    f"of tet {taken[0]}: give them regions that do not overlap."
                )
            owner[tets] = i


def _check_twice(space: ParameterSpace) -> None:
    """Raise if two entries set the same quantity of the setup in one place."""
    taken: dict[tuple[str, ...], SetupParameter] = {}
    for entry in [e for e in space.entries if isinstance(e, SetupParameter)]:
        other = taken.setdefault((entry.kind, entry.of, entry.axis), entry)
        if other is not entry:
            raise ValueError(
                f"parameters {other.label!r} and {entry.label!r} are the same "
                f"quantity, {entry.noun}: give one entry, with all names in `each`."
            )


def check_scopes(space: ParameterSpace, configurations: Sequence[Any]) -> None:
    """Raise ValueError unless each name in `each` is of a fitted configuration."""
    for entry in space.entries:
        if isinstance(entry, SetupParameter):
            known = {entry.member(c) for c in configurations}
            what = f"{entry.by} of parameter {entry.label!r}"
            check_known(what, known, *entry.each)


def _check_effects(model: Any, space: ParameterSpace, configuration: Any) -> None:
    """Raise if an entry sets nothing, or more than the fields that it names.

    Sensitivities follow from `apply` by autodiff, but those of fields use a shortcut
    that misses everything else. Arrays that an entry does not set stay the same object.
    """
    # Copies: a model at the start may hold the very arrays of the parameters.
    values = {q.name: jax.device_put(np.array(q.start)) for q in space.parameters}
    leaves = jax.tree_util.tree_leaves_with_path
    before = dict(leaves((model, configuration)))
    for entry in space.entries:
        after = leaves(entry.apply(model, configuration, values))
        changed = [path for path, leaf in after if before.get(path) is not leaf]
        replaced = set(map(jax.tree_util.keystr, changed))
        named = {"[0]." + find_field(model, name).path for name in entry.fields}
        if not replaced and configuration is not None:
            raise ValueError(
                f"parameter {entry.label!r} sets nothing in the model or in a "
                f"configuration: {type(entry).__name__}.apply must return them changed."
            )
        if named and not replaced <= named:
            raise ValueError(
                f"parameter {entry.label!r} sets {', '.join(sorted(replaced - named))} "
                f"beside its fields: let {type(entry).__name__}.fields be empty."
            )


def _check_order(space: ParameterSpace) -> None:
    """Raise unless the start keeps the order and the bounds leave room for it."""
    plain = space.in_plain_steps()
    A, b = map(np.asarray, plain.order_rows())
    low, high = np.asarray(space.lower()), np.asarray(space.upper())
    excess = A @ np.asarray(space.start()) - b
    best = np.minimum(A * low, A * high).sum(axis=1) - b
    ordered = len(space.order_names())
    for i, (small, large) in enumerate(plain.order_names()):
        # The two moduli of an axis must be able to differ.
        rule, most = ("order", 1e-12) if i < ordered else ("axes", -1e-12)
        if best[i] > most:
            raise ValueError(
                f"the bounds leave no room for {small} <= {large}: lower the bounds of "
                "the first, or raise those of the second."
            )
        if excess[i] > 1e-12:
            raise ValueError(
                f"the start has {small} above {large}, but {rule} names the smaller "
                "first: swap the two, or start with equal or ordered values."
            )


def _check_constants(module: eqx.Module) -> None:
    """Run the checks of a law, and of the modules in it, as at construction."""
    for kind in type(module).__mro__:
        vars(kind).get("__check_init__", lambda _: None)(module)
    for value in vars(module).values():
        if isinstance(value, eqx.Module):
            _check_constants(value)


def default_starts(space: ParameterSpace) -> int:
    """Return how many starts a calibration takes at most, unless the user says so.

    `SEVERAL` where the angle of an axis or more than one control point of a field is
    calibrated, since there the cost has several optima; 1 elsewhere. Mirror images
    included, they take several times as long as a single fit: a sweep of thousands of
    calibrations from good start values may say `starts = 1`.
    """
    fields = [entry.parameters for entry in space.entries if entry.fields]
    angle = any(q.unit == "rad" or q.periodic for field in fields for q in field)
    several = any(len(field) > 1 for field in fields)
    return SEVERAL if space.axes or angle or several else 1


def check_starts(n: int) -> None:
    """Raise ValueError unless there may be so many starts."""
    if n < 1:
        raise ValueError(f"starts must be at least 1, got {n}.")
    TRIALS.check(f"starts = {n}", n)


def random_starts(
    space: ParameterSpace, n: int, *, seed: int = 0
) -> Float[Array, "n p"]:
    """Draw random scaled parameters within the bounds, uniform in SI units.

    Pairs that break their order are swapped.

    Raises:
        ValueError: If n is less than one, or above a limit.
    """
    check_starts(n)
    random = np.random.default_rng(seed)
    low = np.asarray(space.from_scaled(space.lower()))
    high = np.asarray(space.from_scaled(space.upper()))
    p = low + (high - low) * random.random((n, len(low)))
    names = space.names
    pairs = [
        (names.index(small), names.index(large))
        for small, large in space.in_plain_steps().order_names()
        if small in names and large in names  # one may be known
    ]
    for small, large in pairs * len(pairs):  # repeated, for chains a <= b <= c
        p[:, [small, large]] = np.sort(p[:, [small, large]], axis=1)
        p = np.clip(p, low, high)
    numbered = space.numbered
    return jax.device_put(np.stack([_to_scaled(numbered, row) for row in p]))
