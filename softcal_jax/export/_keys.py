"""The keys of `result.json`, which are attributes of results, in SI, mm or %."""

import dataclasses
from collections.abc import Sequence
from typing import Any

from softcal_jax import calibration
from softcal_jax.configurations import EffectorRecord
from softcal_jax.equilibrium import BodyPlace, RobotState
from softcal_jax.export._made import pick
from softcal_jax.identifiability import Assessment, Identifiability, Prediction
from softcal_jax.inference import Uncertainty


class Keys:
    """Keys of an entry, as `pick` takes them from a class; by key those within it."""

    def __init__(self, of: type, names: str = "", **parts: "Keys"):
        """Take all attributes of a dataclass, or those with these names."""
        self.of, self.parts = of, parts
        self.names = names or " ".join(field.name for field in dataclasses.fields(of))

    def entry(self, value: Any) -> Any:
        """Take the keys of one entry, of each of several, or of none."""
        if value is None:
            return None
        if isinstance(value, Sequence):
            return [self.entry(item) for item in value]
        entry = pick(value, self.names)
        return entry | {key: part.entry(entry[key]) for key, part in self.parts.items()}


ROBOT = Keys(
    RobotState,
    "rigid_bodies=bodies actuators reactions",
    rigid_bodies=Keys(
        BodyPlace, "name state position_mm translation_mm rotation_vector"
    ),
)
"""Keys of rigid bodies, actuators and reactions at an equilibrium."""

SIMULATED = Keys(
    calibration.ConfigurationResult,
    "name role converged outcome newton_steps load_steps residual rounding at_rounding "
    "min_det_F largest_displacement_mm rms_after_mm motion_mm markers=points "
    "effectors=others robot",
    markers=Keys(EffectorRecord, "name at_rest_mm measured_mm simulated_mm"),
    effectors=Keys(EffectorRecord, "name unit is_turn measured simulated"),
    robot=ROBOT,
)
"""Keys of a configuration in `simulation.json`."""

IDENTIFIABILITY = Keys(
    Identifiability,
    "verdict n_data precision parameters informed directions covariance correlation "
    "conditioning",
)
"""Keys of what the data tell; null stands for infinite values, too."""

RESULT: dict[str, Keys | None] = {
    **dict.fromkeys(("format", "name", "converged", "source")),
    "parameters": Keys(
        calibration.ParameterEstimate,
        "name value standard_error start lower upper unit at_bound interval given",
    ),
    "intervals": Keys(calibration.ParameterInterval),
    "configurations": Keys(
        calibration.ConfigurationResult,
        "name role rms_before_mm rms_after_mm motion_mm "
        "rms_after_percent_of_motion=rms_share markers=points effectors=others robot "
        "newton_steps residual rounding at_rounding min_det_F",
        markers=Keys(
            EffectorRecord,
            "name measured_mm simulated_before_mm simulated_mm residual_mm",
        ),
        effectors=Keys(
            EffectorRecord,
            "name unit is_turn measured simulated_before simulated residual",
        ),
        robot=ROBOT,
    ),
    "history": Keys(
        calibration.HistoryEntry,
        "step cost lambda_p step_bound accepted kkt_residual newton_steps values "
        "noise_level seconds rms_mm",
    ),
    **dict.fromkeys(("solver", "settings")),
    "uncertainty": Keys(
        Uncertainty,
        "noise noise_scale degrees_of_freedom chi_squared covariance correlation",
    ),
    "budget": None,
    "noise": Keys(calibration.CorrelatedNoise, "jitter share offset_mm"),
    "checks": Keys(
        calibration.ResidualChecks,
        "reasons agreement lack_of_fit recordings level probability left_out",
        left_out=Keys(
            calibration.LeftOut,
            "name rms_mm expected_mm motion_mm probability by_scatter",
        ),
    ),
    "assessment": Keys(
        Assessment,
        "outcome contradicted reasons misfit_probability predictions",
        predictions=Keys(Prediction, "name role std_mm"),
    ),
    "identifiability": IDENTIFIABILITY,
    "starts": Keys(
        calibration.MultiStartResult,
        "names starts values cost steps converged optima second_best missed",
    ),
    **dict.fromkeys(("mistakes", "notes", "versions", "timing_s")),
}
"""All keys in their order, and those within them that are attributes, too."""
