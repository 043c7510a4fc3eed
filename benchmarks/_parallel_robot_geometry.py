"""Shape and arms of the parallel robot of Sec. VI: two sheets, a rod, six motors."""

import math
from collections.abc import Mapping
from functools import partial
from itertools import product

import numpy as np

from benchmarks._tripod import tripod
from softcal_jax._module import Module
from softcal_jax._typing import Float, HostArray
from softcal_jax.bodies import Pose
from softcal_jax.fields import ControlPoints
from softcal_jax.mesh import TetMesh

SHEETS = {"lower": -1.0, "upper": 1.0}
"""The sheets, and the side of the middle on which they lie along y."""

N_BRANCHES = 3


class Arm(Module):
    """A motor's arm and the branch end that is rigid on it.

    The end moves from the flat sheet in two steps: `mounting` shifts it onto the arm at
    angle zero, where the arm points at the robot's axis; then the motor turns it by its
    angle about the fixed line through `axis_point`.

    Attributes:
        name: "lower 1" to "upper 3".
        end: Group of the mesh that the arm carries.
        origin: Middle of the branch end at rest, on the mid-surface of the sheet [m].
        axis_point: Point of the motor axis [m].
        axis_direction: Unit vector along the motor axis [-]: a positive angle turns the
            inward direction of the branch, -e_r, towards the robot's middle, e_a.
        mounting: Motion of the end onto the arm at the angle zero.
    """

    name: str
    end: str
    origin: Float[HostArray, "3"]
    axis_point: Float[HostArray, "3"]
    axis_direction: Float[HostArray, "3"]
    mounting: Pose


class ParallelRobotGeometry(Module):
    """The parallel robot of Sec. VI at rest, flat and unstrained.

    The robot's axis is y, and its middle the origin. The sheets lie in (x, z) planes;
    azimuths and theta count from +x towards +z; gravity acts along -z. Each sheet has
    branches at 0, 120 and 240 degrees, held at their ends by motor arms, and its centre
    is rigid on a rod along y, which pulls both sheets towards the middle.

    "Published" numbers are the authors' (paper and scene), the others are ours.

    Attributes:
        branch_length: From the centre of a sheet, published [m].
        branch_width: Published [m].
        thickness: Of a sheet, along y, published [m].
        hole_radius: Published [m].
        sheet_mass: Mass of one sheet, published [kg].
        sheet_height: Distance of the flat mid-surfaces from the middle, published [m].
        centre_radius: Within it a sheet is rigid on the rod, published [m].
        rod_half_length: Distance from the middle at which the rod holds the centres,
            published [m].
        end_length: Part of a branch that is rigid on its arm, published [m].
        axis_radius: Distance of the motor axes from the robot's axis [m].
        axis_height: Distance of the motor axes from the middle along y [m].
        arm_length: From the motor axis to the middle of the branch end [m].
        inner_radius: Where the inner control point of a branch lies [m].
        outer_radius: Where the outer control point of a branch lies [m].
        ring_radius: Where the six control points around the centre lie [m].
        E_t: Modulus across the fibre before calibration [Pa].
        E_l: Modulus along the fibre before calibration [Pa].
        nu: Poisson's ratio [-].
        spiral_angle: Angle of the fibre from the radius before calibration [rad].
        gravity: Acceleration along -z [m/s2].
    """

    branch_length: float = 0.066
    branch_width: float = 0.030
    thickness: float = 0.005
    hole_radius: float = 0.005
    sheet_mass: float = 0.032
    sheet_height: float = 0.060
    centre_radius: float = 0.0075
    rod_half_length: float = 0.040
    end_length: float = 0.015
    axis_radius: float = 0.066
    axis_height: float = 0.090
    arm_length: float = 0.030
    inner_radius: float = 0.026
    outer_radius: float = 0.042
    ring_radius: float = 0.013
    E_t: float = 1400e3
    E_l: float = 350e3
    nu: float = 0.3
    spiral_angle: float = math.radians(60.0)
    gravity: float = 9.81

    def __check_init__(self):
        for name, value in vars(self).items():
            signed = name in ("spiral_angle", "nu")
            if not signed and not (np.isfinite(value) and value > 0.0):
                raise ValueError(f"{name} must be positive and finite, got {value}.")
        if self.rod_half_length > self.sheet_height:
            raise ValueError(
                f"rod_half_length {self.rod_half_length:g} m exceeds sheet_height "
                f"{self.sheet_height:g} m: the rod would push the sheets apart."
            )

    @property
    def azimuths(self) -> Float[HostArray, "3"]:
        """Directions of the branches, from +x towards +z [rad]."""
        return 2.0 * np.pi * np.arange(N_BRANCHES) / N_BRANCHES

    @property
    def density(self) -> float:
        """Mass over the volume of the sheet with a round hole [kg/m3]."""
        half = self.branch_width / 2.0
        root = half / math.tan(math.pi / N_BRANCHES)
        strips = self.branch_width * (self.branch_length - root) + half * root
        area = N_BRANCHES * strips - math.pi * self.hole_radius**2
        return self.sheet_mass / (area * self.thickness)

    @property
    def rod_pull(self) -> float:
        """How far the rod pulls each sheet towards the middle [m]."""
        return self.sheet_height - self.rod_half_length

    def mesh(self, *, size: float = 0.005, order: int = 2) -> TetMesh:
        """Mesh the two flat sheets, with groups like "lower/end 1" and "upper/centre".

        Args:
            size: Edge length in the plane of a sheet [m].
            order: 2 for quadratic tets; linear ones are wrong by a factor 1.7 in twist.

        Raises:
            ValueError: If `tripod` refuses the dimensions.
        """
        heights = {name: side * self.sheet_height for name, side in SHEETS.items()}
        sheet = partial(self.sheet, size=size, order=order)
        return merge({name: sheet(y) for name, y in heights.items()})

    def sheet(self, y: float = 0.0, *, size: float, order: int = 2) -> TetMesh:
        """Mesh one flat sheet at a height y [m], see `mesh`."""
        return tripod(
            self.branch_length,
            self.branch_width,
            self.thickness,
            hole_radius=self.hole_radius,
            centre_radius=self.centre_radius,
            end_length=self.end_length,
            branches=N_BRANCHES,
            y=y,
            size=size,
            order=order,
        )

    def control_points(self) -> ControlPoints:
        """Build the twelve control points that both sheets share, as in Fig. 6.

        Two on each branch and six around the centre, at y = 0 and for distances in the
        (x, z) plane: "CP branch 1 inner", ..., "CP ring 30 deg", ...
        """
        places = {
            name: (radius * math.cos(azimuth), 0.0, radius * math.sin(azimuth))
            for name, (radius, azimuth) in self._control_point_places().items()
        }
        return ControlPoints(places, axes="xz")

    def start_angles(self) -> Float[HostArray, " n_cp"]:
        """Compute theta at the control points before calibration [rad].

        The fibre is a spiral: theta is the azimuth plus `spiral_angle`, and may exceed
        half a turn, its period.
        """
        azimuths = [azimuth for _, azimuth in self._control_point_places().values()]
        return np.array(azimuths) + self.spiral_angle

    def _control_point_places(self) -> dict[str, tuple[float, float]]:
        """Radius [m] and azimuth [rad] of each control point."""
        radii = {"inner": self.inner_radius, "outer": self.outer_radius}
        on_branches = {
            f"CP branch {k} {name}": (radius, float(azimuth))
            for k, azimuth in enumerate(self.azimuths, start=1)
            for name, radius in radii.items()
        }
        ring = {
            f"CP ring {degrees} deg": (self.ring_radius, math.radians(degrees))
            for degrees in range(30, 360, 60)
        }
        return on_branches | ring

    def arms(self) -> tuple[Arm, ...]:
        """Build the six arms: "lower 1", "lower 2", "lower 3", "upper 1", ..."""
        arms, e_y = [], np.array([0.0, 1.0, 0.0])
        middle_of_end = self.branch_length - self.end_length / 2.0
        for (sheet, side), branch in product(SHEETS.items(), range(N_BRANCHES)):
            azimuth = self.azimuths[branch]
            e_r = np.array([np.cos(azimuth), 0.0, np.sin(azimuth)])
            origin = middle_of_end * e_r + side * self.sheet_height * e_y
            axis_point = self.axis_radius * e_r + side * self.axis_height * e_y
            on_arm = axis_point - self.arm_length * e_r
            arm = Arm(
                name=f"{sheet} {branch + 1}",
                end=f"{sheet}/end {branch + 1}",
                origin=origin,
                axis_point=axis_point,
                # axis x (-e_r) = e_a, the direction along y towards the middle.
                axis_direction=np.cross(-side * e_y, e_r),
                mounting=Pose(on_arm - origin, np.zeros(3)),
            )
            arms.append(arm)
        return tuple(arms)


def merge(parts: Mapping[str, TetMesh]) -> TetMesh:
    """Combine meshes of the same order into one; parts that touch are not joined.

    Nodes and tets come part by part, in the order of the mapping, and keep their order
    within a part. The tet group "lower" is all of the part "lower", and its groups
    become "lower/end 1", "lower/top" and so on, so laws can differ between parts.
    `check_mesh` refuses the result as disconnected: check the parts.

    Raises:
        ValueError: If no part is given, a name is empty or holds a "/", or the parts
            are linear and quadratic ones.
    """
    if not parts:
        raise ValueError("merge needs at least one part.")
    for name in parts:
        if not name or "/" in name:
            raise ValueError(
                f"a part cannot have the name {name!r}: it becomes the first half of "
                'names like "lower/end 1", so it needs letters and no "/".'
            )
    orders = {name: mesh.order for name, mesh in parts.items()}
    if len(set(orders.values())) > 1:
        listed = ", ".join(f"{name!r} {order}" for name, order in orders.items())
        raise ValueError(
            f"the parts must have the same order, got {listed}; use to_quadratic or "
            "to_linear."
        )
    points, tets, n_nodes, n_tets = [], [], 0, 0
    nodes, surfaces, whole, regions = {}, {}, {}, {}
    for part, mesh in parts.items():
        points.append(mesh.points)
        tets.append(mesh.tets + n_nodes)
        whole[part] = n_tets + np.arange(mesh.n_tets)
        for merged, shift, groups in (
            (nodes, n_nodes, mesh.node_groups),
            (surfaces, n_nodes, mesh.surface_groups),
            (regions, n_tets, mesh.tet_groups),
        ):
            merged.update({f"{part}/{k}": group + shift for k, group in groups.items()})
        n_nodes, n_tets = n_nodes + mesh.n_nodes, n_tets + mesh.n_tets
    return TetMesh(
        np.concatenate(points), np.concatenate(tets), nodes, surfaces, whole | regions
    )
