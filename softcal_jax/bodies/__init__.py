"""Rigid bodies: groups of nodes that move as one frame."""

from softcal_jax.bodies._pose import Pose

__all__ = ["Pose"]
