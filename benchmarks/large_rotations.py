"""Large rotations: Newton iterations from rest, under one load, and beside FElupe.

- `bend`: cantilevers of quadratic tets under a force on their end, which comes down by
  7 to 73 % of the length (the thin one by up to 90 %), at four Poisson's ratios.
- `buckle`: a column under 1.1 to 4 times its Euler load, with 1 % of it across.
- `turn`: the held end of a rod of 20 elements goes round a full circle.
- `roll`: a couple about a fixed axis on that end does the same (M = 2 pi E I / L), at
  two Poisson's ratios. A side of the rod is held in its plane: a couple that does not
  follow makes a square rod give way sideways.
- `felupe`: the same cantilevers in FElupe, with the fewest equal load steps among 1, 2,
  5, 10, 20, 50 and 100 that converge: its iterations, and its time over ours.
- `random`: random bodies and loads with limit points and buckling. `false_stable`
  counts solutions that are called stable, and whose tangent at that state has a
  negative eigenvalue by LAPACK; `solved_percent` have a solution.

Figures are Newton iterations, unless their names say otherwise.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import felupe as fem
import jax
import numpy as np

from benchmarks._cantilever import solve
from benchmarks._felupe import linear_solvers
from benchmarks._problem import Figure, Goal, Options, Outcome, Table
from benchmarks._timing import interleave, median_ms, ratio
from softcal_jax.actuators import AbstractActuator, Kind, Motor
from softcal_jax.bodies import Pose, RigidBody
from softcal_jax.configurations import (
    Configuration,
    ImposedForce,
    Support,
    SurfaceForce,
)
from softcal_jax.equilibrium import (
    EquilibriumSolution,
    Formulation,
    Model,
    build_model,
    lanes,
    tangent_values,
)
from softcal_jax.materials import (
    AbstractLaw,
    Corotational,
    Isotropic,
    NeoHookean,
    StVenantKirchhoff,
    Yeoh,
)
from softcal_jax.mesh import beam

E = 150e3
NO_WEIGHT = (0.0, 0.0, 0.0)
COUNTS = {"bend": 6, "buckle": 4, "turn": 1, "roll": 1, "felupe": 6, "random": 200}


class Body(NamedTuple):
    """A cantilever [m], its cells, and the loads on its end [N].

    `wanted` are the iterations that are wanted of each load.
    """

    size: tuple[float, float, float]
    cells: tuple[int, int, int]
    nu: float
    formulation: Formulation
    loads: tuple[float, ...]
    wanted: tuple[int, ...]

    def model(self, law: AbstractLaw | None = None) -> Model:
        """Its model, neo-Hookean unless it is given another law."""
        mesh = beam(*self.size, self.cells, order=2)
        law = law or NeoHookean(E, self.nu)
        return build_model(mesh, law, density=0.0, formulation=self.formulation)


STUBBY = (0.1, 0.02, 0.02), (6, 1, 1)
SLENDER = (0.1, 0.01, 0.01), (20, 2, 2)
THIN = (0.2, 0.005, 0.005), (40, 1, 1)
FORCES = (0.05, 0.1, 0.2, 0.4, 0.8, 1.6)
LIGHT = tuple(force / 16.0 for force in FORCES)
MEAN: Formulation = "mean-dilatation"
BODIES = {
    "stubby": Body(*STUBBY, 0.45, "displacement", FORCES, (5, 5, 6, 7, 9, 13)),
    "slender": Body(*SLENDER, 0.45, "displacement", LIGHT, (5, 5, 6, 7, 8, 10)),
    "stubby_499": Body(*STUBBY, 0.499, MEAN, FORCES, (8, 9, 15, 25, 35, 45)),
    "slender_4999": Body(*SLENDER, 0.4999, MEAN, LIGHT, (6, 6, 7, 12, 20, 30)),
    "thin": Body(
        *THIN,
        0.45,
        "displacement",
        (4e-5, 1e-4, 3e-4, 6e-4, 1.2e-3, 5e-3),
        (4, 5, 7, 8, 9, 10),
    ),
    "corotational": Body(*STUBBY, 0.45, "displacement", FORCES, (9,) * 6),
}
ROD = (0.1, 0.005)
"""Length of the rod that is bent to a circle, and its side [m]."""

COLUMN = {1.1: 60, 1.5: 60, 2.0: 60, 4.0: 60}
GOALS = {
    **{
        f"{name}_{i}": Goal("at most", most)
        for name, body in BODIES.items()
        for i, most in enumerate(body.wanted, 1)
    },
    **{f"column_{k:g}": Goal("at most", most) for k, most in COLUMN.items()},
    "roll": Goal("at most", 25),
    "false_stable": Goal("at most", 0),
}


def run(options: Options) -> Outcome:
    """Run the parts that are asked for; `bend=n` and `felupe=n` take the first n."""
    counts = options.counts or COUNTS
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    tables = []
    if n := counts.get("bend"):
        rows = []
        for name, body in list(BODIES.items())[:n]:
            options.say(f"{name} cantilever")
            found = _bent(name, body)
            figures |= found
            rows.append([name, *(f"{value:.3g}" for value in found.values())])
        columns = ["body", *(f"{of} {i}" for i in range(1, 7) for of in ("load", "%"))]
        tables.append(
            Table("Iterations from rest, and tip in % of the length", columns, rows)
        )
    if counts.get("buckle"):
        options.say("columns")
        figures |= _columns()
    if counts.get("turn"):
        options.say("a full circle")
        figures |= _circle()
    if counts.get("roll"):
        options.say("rolled up by a couple")
        figures |= _rolled()
    if n := counts.get("felupe"):
        for name in ("stubby", "slender"):
            options.say(f"{name} cantilever in FElupe")
            of_loads, seconds = _beside_felupe(name, BODIES[name], n)
            figures |= of_loads
            samples |= seconds
    if n := counts.get("random"):
        options.say(f"{n} random bodies")
        figures |= _random(n)
    goals = {name: goal for name, goal in GOALS.items() if name in figures}
    return Outcome(figures, samples, goals, tables)


def _pulled(model: Model, force: tuple[float, float, float]) -> EquilibriumSolution:
    pose = Configuration("p", "x_min", NO_WEIGHT, loads=SurfaceForce("x_max", force))
    return jax.block_until_ready(solve(model, lanes(model, pose)[0]))


def _iterations(solution: EquilibriumSolution) -> float:
    """Iterations, or infinity, which no goal meets, where none was found."""
    return int(solution.steps) if bool(solution.converged) else 1e6


def _bent(name: str, body: Body) -> dict[str, Figure]:
    law = Corotational(Isotropic(E, body.nu)) if name == "corotational" else None
    model, figures = body.model(law), {}
    end = int(np.argmax(model.mesh.points @ [1.0, 1e-3, 1e-3]))
    for i, force in enumerate(body.loads, 1):
        solution = _pulled(model, (0.0, 0.0, -force))
        figures[f"{name}_{i}"] = _iterations(solution)
        tip = -100.0 * float(solution.displacement[end, 2]) / body.size[0]
        figures[f"{name}_{i}_tip_percent"] = tip if np.isfinite(tip) else 1e6
    return figures


def _columns() -> dict[str, Figure]:
    body = BODIES["slender"]
    model, (length, side, _) = body.model(), body.size
    euler = np.pi**2 * E * side**4 / 12.0 / (4.0 * length**2)
    return {
        f"column_{k:g}": _iterations(
            _pulled(model, (-k * euler, 0.0, 0.01 * k * euler))
        )
        for k in COLUMN
    }


def _rod(nu: float, couples: Sequence[AbstractActuator] = ()) -> Model:
    """A rod of square section with a plate on its end."""
    length, side = ROD
    mesh = beam(length, side, side, (20, 1, 1), order=2)
    centre, axes = (length, 0.5 * side, 0.5 * side), np.roll(np.eye(3), 1, axis=0)
    plate = RigidBody("plate", "x_max", origin=centre, axes=axes)  # its third axis is y
    return build_model(
        mesh, NeoHookean(E, nu), density=0.0, bodies=[plate], actuators=couples
    )


def _circle() -> dict[str, Figure]:
    model = _rod(0.45)
    once = Pose((-ROD[0], 0.0, 0.0), (0.0, -2.0 * np.pi, 0.0))
    pose = Configuration("once", "x_min", NO_WEIGHT, bodies={"plate": once})
    solution = jax.block_until_ready(solve(model, lanes(model, pose)[0]))
    return {"circle": _iterations(solution)}


class Couple(AbstractActuator):
    """A torque about the third axis of a free body, which is fixed in space."""

    body: str
    kind: ClassVar[Kind] = Kind("couple", "N m", "rad")

    def cliques(self, rest: Any, owner: int) -> Any:
        """Its angle is that of the body's frame."""
        return Motor(self.label, self.body).cliques(rest, owner)


def _rolled() -> dict[str, Figure]:
    length, side = ROD
    once = ImposedForce(-2.0 * np.pi * E * side**4 / 12.0 / length)
    found: dict[str, Figure] = {}
    for name, nu in {"roll": 0.0, "roll_45": 0.45}.items():
        model = _rod(nu, [Couple("couple", "plate")])
        x, y, _ = np.asarray(model.mesh.points).T
        side_nodes = np.flatnonzero((y < 1e-9) & (x < length - 1e-9))
        supports = Support("x_min"), Support(side_nodes, "y")
        pose = Configuration("once", supports, NO_WEIGHT, actuation={"couple": once})
        solution = jax.block_until_ready(solve(model, lanes(model, pose)[0]))
        end = np.asarray(solution.displacement[model.mesh.n_nodes])
        gap = 100.0 * float(np.hypot(end[0] + length, end[2])) / length
        found |= {name: _iterations(solution), f"{name}_gap_percent": gap}
    return found


class FelupeCantilever:
    """The cantilever on the same mesh in FElupe, with forces on its nodes."""

    def __init__(self, model: Model, body: Body, forces: np.ndarray):
        """Mesh, law and loads.

        Args:
            model: The cantilever, for its mesh.
            body: The cantilever.
            forces: Forces of all nodes at full load [N].
        """
        lam = E * body.nu / ((1.0 + body.nu) * (1.0 - 2.0 * body.nu))
        mesh = fem.Mesh(model.mesh.points, model.mesh.tets, "tetra10")
        self.field = fem.FieldContainer(
            [fem.Field(fem.RegionQuadraticTetra(mesh), dim=3)]
        )
        law = fem.NeoHookeCompressible(mu=E / (2.0 * (1.0 + body.nu)), lmbda=lam)
        self.loaded = np.flatnonzero(np.any(forces != 0.0, axis=1))
        self.forces = forces[self.loaded]
        self.load = fem.PointLoad(self.field, self.loaded)
        self.items = [fem.SolidBody(law, self.field), self.load]
        clamp = {"clamp": fem.Boundary(self.field[0], fx=lambda x: x == 0.0)}
        self.held, self.free = fem.dof.partition(self.field, clamp)
        self.solver = linear_solvers()["PARDISO"]

    def solve(self, steps: int) -> tuple[int, np.ndarray] | None:
        """Iterations of all load steps, and displacement [m]; None if one fails."""
        self.field[0].values[:] = 0.0
        x: Any = self.field
        iterations = 0
        for share in np.arange(1, steps + 1) / steps:
            self.load.update(share * self.forces)
            try:
                solution = fem.newtonraphson(
                    x0=x.copy(),
                    items=self.items,
                    dof0=self.held,
                    dof1=self.free,
                    solver=self.solver,
                    tol=1e-8,
                    maxiter=30,
                    verbose=0,
                )
            except ValueError:
                return None
            x, iterations = solution.x, iterations + solution.iterations
        return iterations, x[0].values.copy()


def _beside_felupe(
    name: str, body: Body, most: int
) -> tuple[dict[str, Figure], dict[str, list[float]]]:
    model = body.model()
    figures: dict[str, Figure] = {}
    samples: dict[str, list[float]] = {}
    for i, force in list(enumerate(body.loads, 1))[:most]:
        pose = Configuration(
            "p", "x_min", NO_WEIGHT, loads=SurfaceForce("x_max", (0.0, 0.0, -force))
        )
        lane = lanes(model, pose)[0]
        peer = FelupeCantilever(model, body, np.asarray(lane.dead_loads))
        tried = ((n, peer.solve(n)) for n in (1, 2, 5, 10, 20, 50, 100))
        steps, solved = next((n, s) for n, s in tried if s is not None)
        ours = solve(model, lane)
        apart = np.max(np.abs(solved[1] - ours.displacement)) / body.size[0]
        functions: dict[str, Callable[[], object]] = {
            "ours": lambda lane=lane: jax.block_until_ready(solve(model, lane)),
            "felupe": lambda peer=peer, steps=steps: peer.solve(steps),
        }
        seconds = interleave(functions, 5)
        figures |= {
            f"{name}_{i}_felupe_load_steps": steps,
            f"{name}_{i}_felupe": solved[0],
            f"{name}_{i}_apart": float(apart),
            f"{name}_{i}_ours_ms": median_ms(seconds["ours"]),
            f"{name}_{i}_vs_felupe": ratio(seconds["felupe"], seconds["ours"]),
        }
        samples |= {f"{name}_{i}_{who}_s": times for who, times in seconds.items()}
    return figures, samples


def _random(n: int) -> dict[str, Figure]:
    """Solve random bodies that may buckle, snap, or whose law gives way."""
    models = list(_random_models())
    rng, solved, wrong = np.random.default_rng(7), 0, 0
    for k in range(n):
        model = models[k % len(models)]
        length, side, height = np.ptp(model.mesh.points, axis=0)
        euler = np.pi**2 * E * side * height**3 / 12.0 / (4.0 * length**2)
        most = min(3.0 * euler, 0.3 * E * side * height)
        axial = rng.uniform(-1.0, 0.5) * most
        across = rng.uniform(-0.1, 0.1, 2) * abs(axial)
        solution = _pulled(model, (axial, *across))
        if bool(solution.converged):
            solved += 1
            wrong += _lowest(model, solution) < 0.0
    return {"false_stable": wrong, "solved_percent": 100.0 * solved / n}


def _random_models() -> Iterator[Model]:
    """Columns and blocks of laws that stay stable, and of two that do not."""
    laws: list[tuple[AbstractLaw, Formulation]] = [
        (NeoHookean(E, 0.3), "displacement"),
        (NeoHookean(E, 0.499), "mean-dilatation"),
        (StVenantKirchhoff(Isotropic(E, 0.3)), "displacement"),
        (Yeoh(E / 6.0, -E / 60.0, 0.0, 0.45), "displacement"),
        (Corotational(Isotropic(E, 0.4)), "displacement"),
    ]
    for law, formulation in laws:
        for length, cells in ((0.1, (8, 1, 1)), (0.03, (3, 1, 1))):
            mesh = beam(length, 0.01, 0.008, cells, order=2)
            yield build_model(mesh, law, density=0.0, formulation=formulation)


_values = eqx.filter_jit(tangent_values)


def _lowest(model: Model, solution: EquilibriumSolution) -> float:
    """Lowest eigenvalue of the tangent at a solution, over the largest [-]."""
    from scipy.sparse import csr_array

    pattern = model.pattern
    values = np.asarray(_values(model, solution.displacement))
    n = 3 * model.n_points
    half = csr_array((values, (pattern.rows, pattern.indices)), (n, n)).toarray()
    K = half + np.triu(half, 1).T if pattern.symmetric else half
    free = np.repeat(model.mesh.points[:, 0] > 1e-9, 3)
    eigenvalues = np.linalg.eigvalsh(K[np.ix_(free, free)])
    return float(eigenvalues[0] / eigenvalues[-1])
