"""An isotropic matrix with fibres as stiff as thread, in one or two families."""

from dataclasses import replace
from typing import Literal, NamedTuple

import equinox as eqx
import jax.numpy as jnp

from softcal_jax._typing import Array, Float
from softcal_jax.elements import sum_of
from softcal_jax.materials._constants import FIBRES, Constant, as_field
from softcal_jax.materials._fibre import Fibre
from softcal_jax.materials._law import AbstractLaw, Matrix, Tensor, outer, paired


class _Void(AbstractLaw):
    """No material."""

    def energy_density(self, F: Matrix) -> Float[Array, ""]:
        return jnp.zeros((), F.dtype)


BUCKLING = 1e-4
"""Strain c at which a fibre that carries tension only gives way to a push [-]."""


class _Stretched(NamedTuple):
    """State of one family; energy w, w' (pull) and w'' (slope) are over E_f [-]."""

    u: Float[Array, "3"]
    n: Matrix  # F u / l times u^T, derivative of l
    stretch: Float[Array, ""]
    energy: Float[Array, ""]
    pull: Float[Array, ""]
    slope: Float[Array, ""]


class FibreReinforced(AbstractLaw):
    """An isotropic matrix and, along its fibres, the energy of pulled thread.

        psi = psi_matrix(F) + sum over families of w(l - 1),   l = |F u|

    with w(e) = E_f e^2 / 2: the nominal stress of a fibre is E_f (l - 1), as in a
    thread of constant modulus. (A matrix and a function of the fibre stretch: Spencer,
    Deformations of Fibre-Reinforced Materials, 1972; Holzapfel, Gasser and Ogden, J.
    Elasticity 61, 2000.) The matrix may be any isotropic law, nearly incompressible
    too: its `nu` chooses the formulation of the tets, which leaves the fibres' own
    stretch alone (see `parts`).

    With `tension_only`, a fibre that is shortened gives way as a thread that buckles,

        w' = E_f e  for e >= 0,     w' = -E_f c (1 - exp(e / c))  below,  c = 1e-4.

    So the tangent is continuous, as Newton's method needs, and at rest that of the
    pulled fibre; the stress of a push stays below 1e-4 E_f. (Without any stress, the
    tangent would rise from zero where the thread is drawn straight; inflating a wound
    tube from rest then took four times as many iterations.)

    For fibres that are the soft axis of a foam see `TransverseHyperelastic`.

    Attributes:
        matrix: Isotropic law of the matrix.
        E_f: Young's modulus that each family adds along itself: that of the thread
            times its share of the volume [Pa]; 0 where there are no fibres.
        fibre: Direction of the fibres in the rest shape.
        families: 1, or 2 for a second family at -theta: a body wound both ways.
        tension_only: Whether fibres go slack when they are shortened.
    """

    matrix: AbstractLaw
    E_f: Constant = eqx.field(converter=as_field, metadata=FIBRES)
    fibre: Fibre
    families: Literal[1, 2] = eqx.field(static=True, default=1)
    tension_only: bool = eqx.field(static=True, default=False)

    def __check_init__(self):
        if not getattr(self.matrix, "conservative", False):
            raise ValueError(
                "matrix must be a law with a potential, like Corotational or "
                f"NeoHookean(264e3, 0.499), got {self.matrix!r}."
            )
        if self.families not in (1, 2):
            raise ValueError(f"families must be 1 or 2, got {self.families!r}.")

    def fibres(self) -> tuple[Fibre, ...]:
        """Return the fibres of the families."""
        return (self.fibre, self.fibre.mirrored())[: self.families]

    def _fibres(self, F: Matrix) -> list[_Stretched]:
        """Compute the state of each family."""
        states = []
        for fibre in self.fibres():
            u = fibre.direction()
            f = jnp.sum(F * u[None, :], axis=1)
            stretch = jnp.sqrt(jnp.sum(f * f))
            n = (f / stretch)[:, None] * u[None, :]
            states.append(_Stretched(u, n, stretch, *self._pull(stretch - 1.0)))
        return states

    def _pull(self, e: Float[Array, ""]) -> tuple[Float[Array, ""], ...]:
        """Energy w of a fibre over E_f, and its derivatives by the strain e."""
        if not self.tension_only:
            return 0.5 * e * e, e, jnp.ones_like(e)
        pushed = jnp.minimum(e, 0.0) / BUCKLING
        given = jnp.expm1(pushed)
        energy = jnp.where(e >= 0.0, 0.5 * e * e, BUCKLING**2 * (given - pushed))
        return energy, jnp.where(e >= 0.0, e, BUCKLING * given), jnp.exp(pushed)

    def energy_density(self, F: Matrix) -> Float[Array, ""]:
        pulled = sum_of(fibre.energy for fibre in self._fibres(F))
        return self.matrix.energy_density(F) + self.E_f * pulled

    def stress(self, F: Matrix) -> Matrix:
        """First Piola-Kirchhoff stress: matrix, and w' n u^T of each family [Pa]."""
        pulled = sum_of(fibre.pull * fibre.n for fibre in self._fibres(F))
        return self.matrix.stress(F) + self.E_f * pulled

    def tangent(self, F: Matrix) -> Tensor:
        return self.matrix.tangent(F) + self._fibre_tangent(F)

    def _fibre_tangent(self, F: Matrix) -> Tensor:
        """Sum (w'/l delta_ik + (w'' - w'/l) n_i n_k) u_J u_L of fibres, n = F u / l."""

        def of(fibre: _Stretched) -> Tensor:
            turning = fibre.pull / fibre.stretch
            along = paired(jnp.eye(3), fibre.u[:, None] * fibre.u[None, :])
            return turning * along + (fibre.slope - turning) * outer(fibre.n, fibre.n)

        return self.E_f * sum_of(map(of, self._fibres(F)))

    def stress_and_tangent(self, F: Matrix) -> tuple[Matrix, Tensor]:
        P, A = self.matrix.stress_and_tangent(F)
        pulled = sum_of(fibre.pull * fibre.n for fibre in self._fibres(F))
        return P + self.E_f * pulled, A + self._fibre_tangent(F)

    def tabulated(self) -> "FibreReinforced":
        return eqx.tree_at(lambda law: law.matrix, self, self.matrix.tabulated())

    def parts(self) -> tuple[AbstractLaw, AbstractLaw]:
        return self.matrix, replace(self, matrix=_Void())
