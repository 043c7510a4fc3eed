"""Outcomes of the numerical parts, with readable messages."""

import equinox as eqx


class RESULTS(eqx.Enumeration):
    """Outcome of an equilibrium: a traced value, compared with `==`."""

    converged = "converged"
    max_steps = (
        "Newton did not converge within max_steps; check that the load is what you "
        "meant (units of force, density, modulus), that no region is over 1e5 times "
        "stiffer than another and that nothing can move with hardly any energy, as a "
        "mechanism does, or raise max_steps ([newton] in a project file)"
    )
    limit_point = (
        "a limit point: the largest load that the body bears on this path; no stable "
        "equilibrium was found from here at a higher one. Check modulus, wall and "
        "units, reduce the load, or trace the branch with trace_equilibria"
    )
    largest_pressure = (
        "a limit point: the largest pressure that a chamber bears on this path; no "
        "stable equilibrium was found from here at a higher one. Check modulus, wall "
        "and units, lower the pressure, or impose the volume in its place"
    )
    slides = (
        "the body slides: all of it that touches does, and no state was found in which "
        "friction holds it at a higher load. Check the coefficient of friction, the "
        "direction of gravity and supports, or reduce the load"
    )
    law_unstable = (
        "the law loses its stability: along the motion by which the body gives way, it "
        "has less than a quarter of its stiffness at rest. Check its constants and the "
        "load, or take a law that is meant for such strains"
    )
    other_points = (
        "the points of the mesh were set, and the rest of the model did not follow: "
        "use softcal_jax.with_points(model, points)"
    )
    states_used_up = (
        "the path along the load needs more states to reach the full load; raise "
        "`states` of LoadPath"
    )
    load_step_too_small = (
        "load stepping gave up: no Newton step succeeded on the smallest load "
        "increment; the load may be beyond what the body or its law can carry, or "
        "something can move with hardly any energy, as a mechanism does"
    )
    unstable = (
        "the state is unstable: its tangent has negative eigenvalues, as where a body "
        "buckles or snaps through; no stable equilibrium was found from this start"
    )
    singular = (
        "the tangent could not be factorized: it is singular, as for a mechanism or "
        "where stability is lost, or not finite; check the supports and the material"
    )
    inverted = (
        "some tets are inverted (det F <= 0), at the full load or in any load step "
        "further, however small: refine the mesh or reduce the load"
    )
