"""Where a calibration starts, and the standard errors that are asked of it.

For a precision p, 0.1 by default, the asked standard error is

    moduli and other constants of a law, densities,
    factors, stiffnesses                             p times the value
    angles of axes                                   p rad, 5.7 degrees
    Poisson's ratios                                 p / 2
    friction                                         p, a tenth of a pull per radian
    all else of `KINDS`: angles, lengths, offsets    10 p times what is usual

so that an error of the setup counts as known once its standard error is as small as
after careful work. Bounds do not enter: they are typed, not measured.
"""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from softcal_jax._places import TRIALS
from softcal_jax._text import check_known
from softcal_jax._typing import Array, Float, HostArray
from softcal_jax.fields._kinds import KINDS, WITH_STD
from softcal_jax.fields._parameters import (
    AbstractEntry,
    Parameter,
    find_field,
    kind_of,
    region_tets,
)
from softcal_jax.fields._setup import SetupParameter
from softcal_jax.fields._space import ParameterSpace
from softcal_jax.materials import ANGLE, UNREMARKABLE

SEVERAL = 6
"""Most starts by default where there may be several optima."""

order_rows = eqx.filter_jit(lambda space: space.order_rows())  # of a `numbered` one

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
        try:
            applied, _ = space.with_values(model, None, bounds)
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
    if not plain.order_names():  # else the next lines would compile programs
        return
    A, b = map(np.asarray, order_rows(plain.numbered))
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


PRECISION = 0.1
"""Standard error that is asked for by default, relative to the value [-]."""

WEAK_UP_TO = 3.0
"""Standard error, over the asked one, up to which a value is weakly identifiable [-].

With the default precision that is 30 % of a value, or 17 degrees of an axis: an order
of magnitude, which no part can be designed with.
"""

_LEAST = 1e-9
"""Smallest scaled standard error that is asked for: a value of zero would ask for 0."""


def asked_errors(
    space: ParameterSpace,
    z: Float[Array | HostArray, " n_p"],
    precision: float = PRECISION,
    *,
    model: Any = None,
) -> Float[HostArray, " n_p"]:
    """Return the standard errors of the scaled parameters that are asked for [-].

    They follow from the scaled values z and the precision p by the table above. The law
    of the model declares what its constants are; where none does, angles have a unit.

    Raises:
        ValueError: If the precision is not positive and finite, or the model lacks a
            field.
    """
    check_precision(precision)
    sizes = np.abs(np.asarray(space.from_scaled(jax.device_put(z))))
    pairs = [(entry, q) for entry in space.entries for q in entry.parameters]
    each = zip(pairs, sizes.tolist(), strict=True)
    in_si = [precision * _unit(entry, q, size, model) for (entry, q), size in each]
    return np.maximum(in_si / space.slopes(z), _LEAST)


def check_precision(precision: float) -> None:
    """Raise ValueError unless a precision is positive and finite."""
    if not 0.0 < precision < np.inf:
        raise ValueError(f"precision must be positive, like 0.1, got {precision:g}.")


def _unit(entry: AbstractEntry, q: Parameter, size: float, model: Any) -> float:
    """Return the standard error asked for by a precision of 1, in SI units."""
    if isinstance(entry, SetupParameter):
        kind = KINDS[entry.kind]
        if kind.relative:
            return size
        return WITH_STD[kind.uncertain].std / PRECISION if kind.uncertain else 1.0
    known = model is not None and q.field in entry.fields
    kind = kind_of(model, q.field) if known else UNREMARKABLE
    if kind == UNREMARKABLE and q.unit == "rad":
        kind = ANGLE
    return size if kind.asked is None else kind.asked


def field_standard_errors(
    model: Any,
    space: ParameterSpace,
    z: Float[Array, " n_p"],
    covariance: Float[HostArray, "n_p n_p"],
) -> dict[str, Float[HostArray, " n_tets"]]:
    """Compute the standard error of each field that parameters set, in each tet.

    To first order, the square root of the diagonal of J Sigma J^T, where J = df/dz is
    the derivative of the field by the scaled parameters. Where a parameter without a
    standard error acts, with nan in the covariance Sigma of z, the error is nan too.
    Errors are in the unit of their field, by its name in the space.
    """
    known = np.isfinite(np.diag(covariance))
    size, directions = np.linalg.eigh(covariance[np.ix_(known, known)])
    # Rounding may leave a variance slightly below zero.
    root = directions * np.sqrt(np.maximum(size, 0.0))
    errors = {}
    for name, J in zip(space.field_names, _slopes(model, space, z), strict=True):
        J = np.asarray(J)
        error = np.linalg.norm(J[:, known] @ root, axis=1)
        errors[name] = np.where(np.any(J[:, ~known] != 0.0, axis=1), np.nan, error)
    return errors


@eqx.filter_jit
def _slopes(
    model: Any, space: ParameterSpace, z: Float[Array, " n_p"]
) -> list[Float[Array, "n_tets n_p"]]:
    """Differentiate the fields, one value per tet, by the scaled parameters."""

    def fields(z: Float[Array, " n_p"]) -> list[Float[Array, " n_tets"]]:
        changed = space.model_at(model, z)
        values = [find_field(model, name)(changed) for name in space.field_names]
        return [jnp.broadcast_to(value, (model.mesh.n_tets,)) for value in values]

    return jax.jacfwd(fields)(z)
