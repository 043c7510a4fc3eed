"""From the tables [[setup]] of a project file to parameters."""

from pathlib import Path

from softcal_jax.fields import SetupParameter, motor_zero, mounting
from softcal_jax.project._problems import at, known_name
from softcal_jax.project._schema import ProjectTable


def build_setup(path: Path, table: ProjectTable) -> list[SetupParameter]:
    """Errors of motors and mountings that are calibrated along, in the file's order.

    Raises:
        ProjectError: If a motor or a body is unknown.
    """
    motors = [name for name, own in table.actuators.items() if own.type == "motor"]
    found: list[SetupParameter] = []
    for i, own in enumerate(table.setup, start=1):
        options = {"limit": own.limit, "prior_std": own.prior_std}
        for motor in own.motor_zero or ():
            with at(path, f"setup[{i}].motor_zero"):
                known_name("motor", motor, motors, "actuators")
                found.append(motor_zero(motor, **options))
        for body in own.mounting or ():
            with at(path, f"setup[{i}].mounting"):
                known_name("rigid body", body, table.bodies, "bodies")
                nominal = table.bodies[body].mounting.translation
                found += mounting(body, nominal, **options)
    return found
