"""A first project file for a robot, written from its model and its recordings."""

from softcal_jax.exchange.proposal._propose import propose_project, write_ready_made
from softcal_jax.exchange.proposal._recorded import Findings

__all__ = ["Findings", "propose_project", "write_ready_made"]
