"""Models of MuJoCo: a calibrated robot, calibrated again for MuJoCo's flex."""

from softcal_jax.exchange._formats import NotConvergedError as NotConvergedError
from softcal_jax.exchange.mujoco._export import (
    MujocoExport as MujocoExport,
    export_mujoco as export_mujoco,
)
