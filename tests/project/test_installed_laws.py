"""Laws of installed packages, which a project file names by their entry points."""

import sys

import jax.numpy as jnp
import numpy as np
import pytest
from small_project import write_small_project
from wording import says

from softcal_jax.project import ProjectError, load_project

YEOH = """\
import equinox as eqx
import jax.numpy as jnp
from softcal_jax.elements import determinant
from softcal_jax.materials import AbstractLaw, Fibre, constant

class Yeoh(AbstractLaw):
    c1: jnp.ndarray = eqx.field(metadata=constant("Pa", 'stiffness: "30 kPa"'))
    c2: jnp.ndarray = eqx.field(metadata=constant("Pa", 'hardening: "1 kPa"'))
    bulk: jnp.ndarray = eqx.field(metadata=constant("J/m3", 'bulk: "2 MJ/m^3"'))
    skew: jnp.ndarray = eqx.field(metadata=constant("", "a ratio: 0.1"), default=0.5)
    fibre: Fibre = Fibre(0.0)
    power: int = eqx.field(static=True, default=2)

    def energy_density(self, F):
        J = determinant(F)
        I1 = J ** (-2 / 3) * jnp.sum(F * F)
        return (
            self.c1 * (I1 - 3)
            + self.c2 * (I1 - 3) ** self.power
            + self.bulk / 2 * (J - 1) ** 2
        )

class Bare(Yeoh.__base__):
    c1: jnp.ndarray

    def energy_density(self, F):
        return self.c1 * jnp.sum(F * F)
"""
CONSTANTS = 'c1 = "30 kPa"\nc2 = "1 kPa"\nbulk = "0.5 MJ/m^3"\ntheta = "20 deg"\n'
OF_C1 = ('field = "E"\nlower = "100 kPa"\nupper = "1 MPa"', 'field = "c1"\n')
BOUNDS = 'lower = "10 kPa"\nupper = "90 kPa"'


@pytest.fixture
def install(tmp_path, monkeypatch):
    """Puts a package with an entry point where Python finds installed ones."""
    site = tmp_path / "site-packages"
    site.mkdir()
    monkeypatch.syspath_prepend(str(site))

    def installed(entry, *, package="soft-yeoh", module="soft_yeoh", code=YEOH):
        monkeypatch.delitem(sys.modules, module, raising=False)
        (site / f"{module}.py").write_text(code)
        info = site / f"{package.replace('-', '_')}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(
            f"Metadata-Version: 2.1\nName: {package}\nVersion: 1.0\n"
        )
        (info / "entry_points.txt").write_text(f"[softcal_jax.laws]\n{entry}\n")

    yield installed
    for module in ("soft_yeoh", "other_yeoh"):
        sys.modules.pop(module, None)


def with_law(folder, law, constants, *changes):
    """A project of a law, which calibrates nothing but the density."""
    density = 'field = "density"\nlower = "500 kg/m^3"\nupper = "2 g/cm^3"'
    return write_small_project(
        folder,
        ('law = "neo-hookean"\nE = "200 kPa"\nnu = 0.3\n', f"{law}\n{constants}"),
        *(changes or ((OF_C1[0], density),)),
    )


def refusal(path):
    with pytest.raises(ProjectError) as caught:
        load_project(path)
    return str(caught.value).removeprefix(f"{path}: ")


def test_its_constants_are_keys_and_can_be_calibrated(tmp_path, install):
    install("mine = soft_yeoh:Yeoh")
    changes = (OF_C1[0], f"{OF_C1[1]}{BOUNDS}")
    project = load_project(
        with_law(tmp_path, 'law = "mine"', f"{CONSTANTS}power = 3\n", changes)
    )
    law = project.model.law
    assert type(law).__module__ == "soft_yeoh"
    assert law.power == 3
    np.testing.assert_allclose([law.c1, law.c2, law.bulk], [30e3, 1e3, 5e5], rtol=1e-12)
    np.testing.assert_allclose([law.skew, law.fibre.theta], [0.5, np.pi / 9])
    F = jnp.diag(jnp.asarray([1.2, 0.9, 1.0]))
    expected = type(law)(30e3, 1e3, 5e5, power=3)
    np.testing.assert_allclose(law.stress(F), expected.stress(F), rtol=1e-12)
    (c1,) = project.parameters
    assert (c1.name, c1.unit, c1.scale) == ("c1", "Pa", "log")
    np.testing.assert_allclose([c1.start, c1.lower], [30e3, 10e3], rtol=1e-12)


def test_regions_have_its_constants(tmp_path, install):
    install("mine = soft_yeoh:Yeoh")
    regions = (
        '\n[groups.half]\nof = "tets"\n'
        'sphere = { centre = "(60, 10, 10) mm", radius = "20 mm" }\n'
        '[material.regions.half]\nc2 = "7 kPa"\n'
    )
    path = with_law(tmp_path, 'law = "mine"', CONSTANTS)
    path.write_text(path.read_text().replace("[markers]\n", f"{regions}\n[markers]\n"))
    c2 = load_project(path).model.law.c2
    assert set(np.round(np.unique(c2), 9)) == {1e3, 7e3}


MISNAMED = """
import equinox as eqx
import jax
from softcal_jax.materials import POISSON, AbstractLaw, NeoHookean, constant


class Misnamed(AbstractLaw):
    nu: jax.Array = eqx.field(metadata=constant("Pa", 'a modulus: "1 MPa"'))
    E: jax.Array = eqx.field(
        metadata=constant("", "Poisson's ratio: 0.3", within=(-1.0, 0.5), kind=POISSON)
    )

    def energy_density(self, F):
        return NeoHookean(self.nu, self.E).energy_density(F)


class Heavy(Misnamed):
    density: jax.Array = eqx.field(metadata=constant("Pa", 'stiffness: "1 MPa"'))
"""


def test_constants_are_what_they_declare_whatever_their_names(tmp_path, install):
    """A modulus nu and a Poisson's ratio E."""
    install("mine = misnamed:Misnamed", module="misnamed", code=MISNAMED)
    constants = 'nu = "50 kPa"\nE = 0.3\n'
    ratio = '[[parameters]]\nfield = "E"\nlower = 0.1\nupper = 0.45\n'
    of = OF_C1[1].replace("c1", "nu") + BOUNDS + f"\n{ratio}"
    path = with_law(tmp_path, 'law = "mine"', constants, (OF_C1[0], of))
    project = load_project(path)
    assert project.model.formulation == "displacement"
    nu, E = project.parameters
    assert (nu.unit, nu.scale, E.unit, E.scale) == ("Pa", "log", "", "linear")
    path.write_text(path.read_text().replace("upper = 0.45", "upper = 0.6"))
    assert says(refusal(path), "E must lie in (-1, 0.5), got 0.6 ... take 0.499")
    path.write_text(path.read_text().replace("E = 0.3", "E = 0.5"))
    assert says(refusal(path), "E must lie in (-1, 0.5), got 0.5 ... take 0.499")


def test_a_constant_with_the_name_of_a_key_is_refused(tmp_path, install):
    install("mine = misnamed:Heavy", module="misnamed", code=MISNAMED)
    said = refusal(with_law(tmp_path, 'law = "mine"', ""))
    assert says(said, "Heavy.density", "another density", "another name")


@pytest.mark.parametrize(
    ("constants", "message"),
    [
        (
            CONSTANTS.replace('c2 = "1 kPa"\n', ""),
            'material.c2: missing ... "1 kPa"',
        ),
        (
            CONSTANTS.replace('"1 kPa"', '"1 mm"'),
            'material.c2: "1 mm": "mm" is not a pressure',
        ),
        (
            CONSTANTS.replace("MJ", "MN"),
            'material.bulk: "0.5 MN/m^3": "MN/m^3" is not ... J/m3',
        ),
        (
            f'{CONSTANTS}E = "1 MPa"\n',
            'material.E: ... "isotropic" ... "neo-hookean" ... c1, c2, bulk, skew, '
            "theta",
        ),
        (
            f"{CONSTANTS}c3 = 1\n",
            'material.c3: unknown key ... mean "c2" ... law, density',
        ),
    ],
)
def test_its_keys_are_checked(tmp_path, install, constants, message):
    install("mine = soft_yeoh:Yeoh")
    said = refusal(with_law(tmp_path, 'law = "mine"', constants))
    assert says(said, message)


def test_an_unknown_law_lists_it(tmp_path, install):
    install("mine = soft_yeoh:Yeoh", code="raise RuntimeError")
    said = refusal(with_law(tmp_path, 'law = "min"', ""))
    assert says(said, 'material.law: got "min" ... "neo-hookean", ... mean "mine"')
    assert says(said, '"fibre-reinforced", "mine"')
    assert "soft_yeoh" not in sys.modules


@pytest.mark.parametrize(
    ("entry", "code", "message"),
    [
        (
            "soft_yeoh:Yeoh",
            "import not_there",
            'material.law: ... "mine" ... soft-yeoh (soft_yeoh:Yeoh) cannot be '
            "loaded ... 'not_there'",
        ),
        (
            "soft_yeoh:Yoeh",
            YEOH,
            'material.law: ... "mine" ... soft-yeoh (soft_yeoh:Yoeh) cannot be '
            "loaded: AttributeError",
        ),
        (
            "soft_yeoh:YEOH",
            "YEOH = 5",
            'material.law: ... "mine" ... soft-yeoh (soft_yeoh:YEOH) ... 5 ... '
            "AbstractLaw",
        ),
        (
            "soft_yeoh:Bare",
            YEOH,
            'material.law: ... "mine" ... soft-yeoh (soft_yeoh:Bare) ... Bare.c1 has '
            "no unit",
        ),
    ],
)
def test_a_broken_package_matters_where_it_is_named(
    tmp_path, install, entry, code, message
):
    install(f"mine = {entry}", code=code)
    assert load_project(write_small_project(tmp_path / "other")).name == "small"
    assert "soft_yeoh" not in sys.modules
    assert says(refusal(with_law(tmp_path, 'law = "mine"', "")), message)


def test_two_packages_with_one_name(tmp_path, install):
    install("mine = soft_yeoh:Yeoh")
    install("mine = other_yeoh:Yeoh", package="other-yeoh", module="other_yeoh")
    said = refusal(with_law(tmp_path, 'law = "mine"', CONSTANTS))
    assert says(said, 'material.law: ... packages ... "mine" ... uninstall')
    assert "other_yeoh" not in sys.modules


def test_a_law_of_this_package_is_not_replaced(tmp_path, install):
    install("neo-hookean = soft_yeoh:Yeoh")
    law = load_project(write_small_project(tmp_path)).model.law
    assert type(law).__module__.startswith("softcal_jax.")


@pytest.mark.parametrize(
    "name", ["beside", "beside.py", "./beside.py", "beside:Law", "soft_yeoh:Yeoh"]
)
def test_a_file_on_disk_is_never_imported(tmp_path, install, monkeypatch, name):
    """Neither one beside the project, nor a module that Python could import."""
    install("mine = soft_yeoh:Yeoh")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    trace = "from pathlib import Path\nPath('imported').touch()\n"
    (tmp_path / "beside.py").write_text(trace + YEOH.replace("Yeoh", "Law"))
    said = refusal(with_law(tmp_path, f'law = "{name}"', CONSTANTS))
    assert says(said, f'material.law: got "{name}" ... "neo-hookean"')
    assert not (tmp_path / "imported").exists()
    assert not {"beside", "soft_yeoh"} & set(sys.modules)
