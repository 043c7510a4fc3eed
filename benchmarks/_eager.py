"""A gradient through an equilibrium, called eagerly in a new process: `_eager BEGIN`.

Prints as JSON when the first gradient is there, counted from BEGIN [s since 1970], and
how many programs are compiled by second calls.
"""

import json
import sys
import time

import jax

import softcal_jax as sc
from benchmarks._compilations import Compilations


def main() -> None:
    """Take the gradient of a beam's sag by its modulus, then call everything again."""
    begin = float(sys.argv[1])
    jax.config.update("jax_enable_x64", True)
    sc.use_compilation_cache()
    mesh = sc.beam(0.1, 0.02, 0.02, (4, 1, 1))
    model = sc.build_model(mesh, sc.NeoHookean(1e5, 0.3), density=1000.0)
    pose = sc.Configuration("hang", [sc.Support("x_min")])
    tip = int(mesh.points.sum(axis=1).argmax())

    def solved(E):
        return sc.solve_equilibrium(sc.set_field(model, "E", E), pose).displacement

    def sag(E):
        return solved(E)[tip, 2]

    calls = solved, jax.grad(sag), jax.hessian(sag)
    jax.block_until_ready(calls[1](1e5))
    seconds = time.time() - begin
    for call in calls:
        jax.block_until_ready(call(1e5))
    with Compilations() as seen:
        for call in calls:
            jax.block_until_ready(call(1.1e5))
    figures = {"first_gradient_s": seconds, "second_calls": len(seen.programs)}
    print(json.dumps(figures))


if __name__ == "__main__":
    main()
