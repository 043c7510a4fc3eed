"""A first project file for a robot, written from its model and its recordings."""

from softcal_jax.exchange.proposal._propose import (
    propose_project as propose_project,
    write_ready_made as write_ready_made,
)
from softcal_jax.exchange.proposal._recorded import Findings as Findings
