"""Every public record writes itself in one line, whatever its fields hold."""

import dataclasses
import importlib
import inspect

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from export.handmade import make_ranking, make_result, make_simulation_result
from from_code import packages, public_names
from robot_project import write_robot_project

import softcal_jax as sc
from softcal_jax.calibration import CalibrationSettings, ParameterInterval
from softcal_jax.configurations import ImposedDisplacement
from softcal_jax.control import Limits
from softcal_jax.fields import exactly_known
from softcal_jax.materials import Gent, Ogden
from softcal_jax.mesh import Box
from softcal_jax.project import load_project


def public_classes():
    """What the packages offer, without exceptions."""
    classes = {}
    for module in map(importlib.import_module, packages()):
        for name in public_names(module):
            cls = getattr(module, name)
            if inspect.isclass(cls) and not issubclass(cls, BaseException):
                classes[cls] = None
    return [
        cls
        for cls in classes
        if issubclass(cls, eqx.Module) and not cls.__name__.startswith("Abstract")
    ]


PUBLIC = public_classes()


def keys_of(record):
    if dataclasses.is_dataclass(record):
        return [field.name for field in dataclasses.fields(record)]
    return getattr(record, "_fields", ())


def records_in(root, by_class):
    """Adds all records of a tree, by class."""
    if keys_of(root):
        by_class.setdefault(type(root), []).append(root)
        inner = [getattr(root, key) for key in keys_of(root)]
    else:
        inner = root.values() if isinstance(root, dict) else root
        inner = inner if isinstance(root, dict | list | tuple) else ()
    for child in inner:
        records_in(child, by_class)
    return by_class


@pytest.fixture(scope="module")
def records(tmp_path_factory):
    """A robot, its actuators and sensors, and results of every kind, by class."""
    project = load_project(write_robot_project(tmp_path_factory.mktemp("robot")))
    result = make_result()
    simulation = make_simulation_result(result.model)
    roots = [project, result, sc.assess(result), make_ranking(), simulation]
    return records_in(roots, {})


def assert_one_line(text, cls):
    assert text.startswith(cls.__name__)
    assert len(text) <= 120
    assert text.isprintable()


def test_records_of_a_robot_and_its_results(records):
    written = 0
    for cls, instances in records.items():
        for record in instances:
            text = repr(record)
            if cls in PUBLIC:
                assert_one_line(text, cls)
                written += 1
    assert written > 80
    assert len(records.keys() & set(PUBLIC)) > 40


CONTENTS = {
    "numbers": 0.25,
    "nothing": None,
    "a long text": "a name\nof two lines, and \x1b[31m " + 200 * "x",
    "an array": np.linspace(0.0, 1.0, 12).reshape(4, 3),
    "many numbers": jnp.arange(1000.0),
    "no array": np.zeros((0, 3)),
    "words": tuple(f"marker {k}" for k in range(20)),
    "records": (sc.NeoHookean(1e5, 0.3), sc.NeoHookean(2e5, 0.3)),
    "a key": jax.random.key(0),
    "a function": np.linalg.norm,
    "shapes": jax.ShapeDtypeStruct((3, 2), float),
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_whatever_the_fields_hold(content):
    """As trees of arrays are mapped to something else, or records are half-built."""
    for cls in PUBLIC:
        record = object.__new__(cls)
        for key in keys_of(cls):
            object.__setattr__(record, key, content)
        assert_one_line(repr(record), cls)


def test_half_built():
    """As a traceback out of `__init__` shows it."""
    for cls in PUBLIC:
        assert_one_line(repr(object.__new__(cls)), cls)


def cable_finger():
    """A model with a rigid body and a cable."""
    guides = [sc.Guide((0.0, 0.01, 0.002), "ground"), sc.Guide((0.1, 0.01, 0.002))]
    return sc.build_model(
        sc.beam(0.1, 0.02, 0.02, (20, 4, 4), order=2),
        sc.Corotational(sc.Isotropic(3e5, 0.45)),
        density=1100.0,
        bodies=[sc.RigidBody("plate", "x_max")],
        actuators=[sc.Cable("left", guides)],
    )


@pytest.mark.parametrize(
    ("make", "texts"),
    [
        (lambda: sc.NeoHookean(150e3, 0.49), ["NeoHookean", "E = 150 kPa", "nu = 0.4"]),
        (
            lambda: sc.Corotational(sc.Isotropic(300e3, 0.45)),
            ["Corotational", "Isotropic", "E = 300 kPa", "nu = 0.45"],
        ),
        (
            lambda: sc.ReducedTransverseIsotropic(
                E_t=3e5, E_l=4e5, nu=0.3, fibre=sc.Fibre(np.deg2rad(20.0), plane="xy")
            ),
            ["E_t = 300 kPa", "E_l = 400 kPa", "theta = 20 deg"],
        ),
        (lambda: Gent(127e3, 60.0), ["mu = 127 kPa", "J_m = 60", "nu = 0.499"]),
        (
            cable_finger,
            ["Model", "3 321 nodes", "1 920", "Corotational", "plate", "cable left"],
        ),
        (
            lambda: sc.beam(0.1, 0.02, 0.02, (2, 1, 1)),
            ["TetMesh", "12 nodes", "12 linear tets", "x_max", "z_min"],
        ),
        (
            lambda: sc.Parameter(
                "theta", "theta", 0.0, -1.0, 1.0, unit="rad", scale="linear"
            ),
            ['Parameter "theta"', '"linear"', "lower = -57.296 deg"],
        ),
        (
            lambda: sc.Pose((0.01, 0.0, 0.002), (0.0, np.pi / 2, 0.0)),
            ["Pose", "(10, 0, 2) mm", "(0, 90, 0) deg"],
        ),
        (
            lambda: ParameterInterval("E", 0.95, 1e5, 2e5, "likelihood", "bound", "Pa"),
            ['ParameterInterval "E"', "100 to 200", "kPa"],
        ),
        # Pa of a chamber, N of a cable, N m of a motor: only the actuator tells.
        (lambda: ImposedDisplacement(0.02), ["ImposedDisplacement", "value = 0.02"]),
        (make_result, ["CalibrationResult", "4 steps", "240.0 ± 6.0 kPa", "nu = 0.44"]),
    ],
)
def test_class_name_and_values_with_units(make, texts):
    record = make()
    assert_one_line(repr(record), type(record))
    assert all(text in repr(record) for text in texts)


def test_what_is_traced_or_deleted_says_its_shape():
    seen = []

    @jax.jit
    def energy(law):
        seen.append(repr(law))
        return law.energy_density(1.1 * jnp.eye(3))

    energy(sc.NeoHookean(1e5, 0.3))
    assert seen == ["NeoHookean, E = f64[], nu = f64[]"]

    law = sc.NeoHookean(jnp.full(7, 1e5), 0.3)
    law.E.delete()
    assert repr(law) == "NeoHookean, E = f64[7], nu = 0.3"


def test_an_error_under_jit_shows_the_record():
    """And not that it could not be shown."""

    @eqx.filter_jit
    def fails(model):
        raise ValueError(f"no such thing in {model!r}")

    with pytest.raises(ValueError, match=r"Model: 12 nodes, 12 .*NeoHook"):
        fails(
            sc.build_model(
                sc.beam(0.1, 0.02, 0.02, (2, 1, 1)),
                sc.NeoHookean(1e5, 0.3),
                density=1000.0,
            )
        )


def test_all_of_it_is_still_written_by_equinox():
    settings = CalibrationSettings(tol=1.2345678e-6)
    assert eqx.tree_pformat(settings) == "CalibrationSettings(tol=1.2345678e-06)"
    assert repr(Limits(force=(0.0, 5.0)))
    assert repr(exactly_known())
    assert repr(Box((0, 0, 0), (1, 1, 1))).startswith("Box: ")
    assert "mu_1 = 100 kPa" in repr(Ogden(1e5, 2.0, 0.0, 2.0, 0.0, 2.0))
