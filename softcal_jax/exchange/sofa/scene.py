"""SOFA scene of a calibrated robot; README.md says how to run it.

robot.json holds the numbers, in the units that it names. To run another configuration
than the first one, set the environment variable SOFTCAL_CONFIGURATION to its name.
"""

import csv
import json
import os
from pathlib import Path

import numpy as np
import Sofa

FOLDER = Path(__file__).resolve().parent
ROBOT = json.loads((FOLDER / "robot.json").read_text(encoding="utf-8"))
NAME = os.environ.get("SOFTCAL_CONFIGURATION", next(iter(ROBOT["configurations"])))
CONFIGURATION = ROBOT["configurations"][NAME]

TIME_STEP = 1.0
"""Long, so that a body with actuators comes to rest within a few steps [s]."""

PLUGINS = [
    "Sofa.Component.Constraint.Projective",
    "Sofa.Component.IO.Mesh",
    "Sofa.Component.LinearSolver.Direct",
    "Sofa.Component.LinearSolver.Iterative",
    "Sofa.Component.Mass",
    "Sofa.Component.MechanicalLoad",
    "Sofa.Component.ODESolver.Backward",
    "Sofa.Component.SolidMechanics.Spring",
    "Sofa.Component.StateContainer",
    "Sofa.Component.Topology.Container.Dynamic",
    "Sofa.Component.Visual",
    ROBOT["elasticity"]["plugin"],
]
PLUGINS_OF_ACTUATORS = [
    "Sofa.Component.AnimationLoop",
    "Sofa.Component.Constraint.Lagrangian.Correction",
    "Sofa.Component.Constraint.Lagrangian.Solver",
    "Sofa.Component.Mapping.Linear",
    "SoftRobots",
]


class EffectorMonitor(Sofa.Core.Controller):
    """Write where the effectors are after each step to effectors_NAME.csv."""

    def __init__(self, state):
        """Follow the effectors by the positions of a mechanical object."""
        super().__init__(name="monitor")
        self.state, self.step = state, 0
        self.effectors = CONFIGURATION["effectors"]
        self.path = FOLDER / f"effectors_{CONFIGURATION['file']}.csv"
        columns = ["step", "effector", "x", "y", "z", "distance from predicted"]
        self._write("w", [columns])

    def positions(self):
        """Return the positions of all effectors now."""
        x = np.array(self.state.position.value)
        return [np.array(e["weights"]) @ x[e["nodes"]] for e in self.effectors]

    def onAnimateEndEvent(self, event):  # noqa: D102
        self.step += 1
        rows = []
        for effector, x in zip(self.effectors, self.positions(), strict=True):
            apart = float(np.linalg.norm(x - effector["predicted"]))
            rows.append([self.step, effector["name"], *x.tolist(), apart])
            unit = ROBOT["units"]["length"]
            print(f"{effector['name']}: {x} {unit}, predicted {apart:.3g} {unit} away")
        self._write("a", rows)

    def _write(self, mode, rows):
        with self.path.open(mode, newline="", encoding="utf-8") as file:
            csv.writer(file).writerows(rows)


def createScene(root):
    """Build the scene of one configuration."""
    driven = bool(CONFIGURATION["cables"] or CONFIGURATION["chambers"])
    for plugin in PLUGINS + PLUGINS_OF_ACTUATORS * driven:
        root.addObject("RequiredPlugin", name=plugin)
    root.gravity.value = CONFIGURATION["gravity"]
    root.dt.value = TIME_STEP
    flags = "showBehaviorModels showForceFields"
    root.addObject("VisualStyle", displayFlags=flags)
    if driven:
        root.addObject("FreeMotionAnimationLoop")
        precise = {"tolerance": 1e-12, "maxIterations": 10000}
        root.addObject("BlockGaussSeidelConstraintSolver", **precise)
    else:
        root.addObject("DefaultAnimationLoop")

    body = root.addChild("body")
    _add_solvers(body, driven)
    state = _add_body(body)
    _add_supports(body)
    if CONFIGURATION["forces"]["indices"]:
        body.addObject("ConstantForceField", name="loads", **CONFIGURATION["forces"])
    for k, chamber in enumerate(CONFIGURATION["chambers"]):
        body.addObject(
            "SurfacePressureConstraint",
            name=f"chamber{k}",
            triangles=chamber["triangles"],
            **_imposed(chamber),
        )
    for k, cable in enumerate(CONFIGURATION["cables"]):
        _add_cable(body.addChild(f"cable{k}"), cable)
    root.addObject(EffectorMonitor(state))
    return root


def _add_solvers(body, driven):
    """Add Newton's method if nothing drives the body, else implicit steps in time."""
    if driven:
        body.addObject("EulerImplicitSolver", name="ode")
    else:
        # The tangents of SOFA's tets are not exact, so Newton takes many cheap steps.
        body.addObject(
            "NewtonRaphsonSolver",
            name="newton",
            maxNbIterationsNewton=1000,
            maxNbIterationsLineSearch=1,
            warnWhenLineSearchFails=False,
            relativeSuccessiveStoppingThreshold=0.0,
            relativeInitialStoppingThreshold=1e-9,
            absoluteResidualStoppingThreshold=CONFIGURATION["stop at residual"],
        )
        body.addObject("StaticSolver", name="ode", newtonSolver="@newton")
    if ROBOT["elasticity"]["component"] == "TetrahedronAnisotropicForceField":
        # This component turns its products with the tets, but not its assembled matrix.
        precise = {"iterations": 10000, "tolerance": 1e-14, "threshold": 1e-30}
        body.addObject("CGLinearSolver", name="linear", **precise)
    else:
        kind = "CompressedRowSparseMatrixMat3x3"
        body.addObject("SparseLDLSolver", name="linear", template=kind)
    if driven:
        links = {"linearSolver": "@linear", "ODESolver": "@ode"}
        body.addObject("GenericConstraintCorrection", **links)


def _add_body(body):
    """Add mesh, masses and elasticity, and return the mechanical object."""
    body.addObject("MeshVTKLoader", name="loader", filename=str(FOLDER / "robot.vtk"))
    body.addObject(
        "TetrahedronSetTopologyContainer",
        name="tets",
        position="@loader.position",
        tetrahedra="@loader.tetrahedra",
    )
    x, moved = np.array(ROBOT["positions"]), CONFIGURATION["moved"]
    if moved["indices"]:  # by a support, where they start
        x[moved["indices"]] += np.array(moved["displacements"])
    state = body.addObject(
        "MechanicalObject",
        name="state",
        template="Vec3",
        position=x.tolist(),
        rest_position="@loader.position",
    )
    body.addObject("DiagonalMass", name="mass", vertexMass=ROBOT["vertex mass"])
    elasticity = ROBOT["elasticity"]
    body.addObject(elasticity["component"], name="elasticity", **elasticity["data"])
    return state


def _add_supports(body):
    """Add what holds the body: clamps, sliding supports and elastic ones."""
    for k, held in enumerate(CONFIGURATION["held"]):
        nodes = held["indices"]
        if all(held["directions"]):
            body.addObject("FixedProjectiveConstraint", name=f"clamp{k}", indices=nodes)
        else:
            ways = {"indices": nodes, "fixedDirections": held["directions"]}
            body.addObject("PartialFixedProjectiveConstraint", name=f"slide{k}", **ways)
    for k, springs in enumerate(CONFIGURATION["springs"]):
        body.addObject(
            "RestShapeSpringsForceField",
            name=f"springs{k}",
            points=springs["indices"],
            stiffness=springs["stiffness"],
            activeDirections=springs["directions"],
        )


def _add_cable(node, cable):
    """Add a cable through points of the body, from the point it is pulled from."""
    node.addObject("MechanicalObject", template="Vec3", position=cable["points"])
    pulled = cable["pull point"]
    fixed = {"hasPullPoint": False} if pulled is None else {"pullPoint": pulled}
    indices = list(range(len(cable["points"])))
    node.addObject("CableConstraint", indices=indices, **fixed, **_imposed(cable))
    node.addObject("BarycentricMapping", useRestPosition=True)


def _imposed(actuator):
    """Return the value of an actuator; SOFA counts forces as impulses of a step."""
    kind, value = actuator["value type"], actuator["value"]
    impulse = kind in ("force", "pressure")
    return {"valueType": kind, "value": [value * TIME_STEP if impulse else value]}
