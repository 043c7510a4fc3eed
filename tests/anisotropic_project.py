"""A project file for the beam of Sec. V, coarse: nothing is measured yet."""

from pathlib import Path

PROJECT = """\
name = "anisotropic_beam"

[mesh]
beam = { size = "(150, 15, 15) mm", cells = [4, 1, 1] }

[material]
law = "corotational"
elasticity = "reduced-transverse-isotropic"
E_t = "700 kPa"
E_l = "400 kPa"
nu = 0.3
theta = "10 deg"
print_plane = "xz"
density = "948 kg/m^3"

[control_points.ends]
positions = { "CP 1" = "(0, 7.5, 7.5) mm", "CP 2" = "(150, 7.5, 7.5) mm" }
power = 2

[[parameters]]
field = "E_t"
control_points = "ends"
start = { "CP 2" = "0.6 MPa" }
lower = "50 kPa"
upper = "1 MPa"

[[parameters]]
field = "E_l"
control_points = "ends"
lower = "50 kPa"
upper = "1 MPa"

[[parameters]]
field = "theta"
control_points = "ends"
lower = "-90 deg"
upper = "90 deg"
S = "1 rad"

[parameter_space]
axes = [["E_l", "E_t", "theta"]]

[markers]
std = "0.1 mm"

[markers.positions]
tip = "(150, 7.5, 7.5) mm"
foot = "(0, 7.5, 7.5) mm"

[shared]
gravity = "(0, -9.81, 0) m/s^2"
supports = [{ group = "x_min" }]
markers = ["tip"]

[[configurations]]
name = "pose 1"

[[configurations]]
name = "pose 3"
gravity = "(0, 0, 9.81) m/s^2"

[[candidates]]
name = "pose 2"
gravity = "(0, -6.9367, 6.9367) m/s^2"

[[candidates]]
name = "pose 4"
supports = [{ group = "x_max" }]
markers = ["foot"]
"""

MEASURED = """\
pose,marker,x_mm,y_mm,z_mm
pose 1,tip,149.898625370,2.839282835,7.717320689
pose 3,tip,150.042969928,7.291271830,11.697574551
"""
"""Linear tets, E_t = 900 and 600 kPa, E_l = 300 and 200 kPa, theta = 20, -35 deg."""


def write_anisotropic_project(folder: Path, *changes: tuple[str, str]) -> Path:
    """Writes the project, with pieces of it exchanged."""
    text = PROJECT
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times"
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "project.toml"
    path.write_text(text)
    return path


def write_measured_project(folder: Path) -> Path:
    """The project with linear tets, and both configurations measured."""
    path = write_anisotropic_project(
        folder,
        ("cells = [4, 1, 1] }", 'cells = [3, 1, 1] }\nelement = "linear"'),
        (
            '[[configurations]]\nname = "pose 1"\n',
            "[shared.measured]\nfile = "
            '"markers.csv"\n\n[[configurations]]\nname = "pose 1"\n'
            'measured.select = { pose = "pose 1" }\n',
        ),
        (
            'name = "pose 3"\n',
            'name = "pose 3"\nmeasured.select = { pose = "pose 3" }\n',
        ),
    )
    (folder / "markers.csv").write_text(MEASURED)
    return path
