"""A project file that runs in seconds: a short, coarse beam and made-up recordings.

The recordings are this package's own equilibria with E = 300 kPa, seen by a camera
whose frame is turned and shifted, and a tip marker that was glued 1 mm off: E comes out
only if the registration, the displacements, the loads and the units are all right.
"""

from hashlib import sha256
from pathlib import Path

E_TRUE = 300e3

PROJECT = """\
name = "small"

[mesh]
beam = { size = "(60, 20, 20) mm", cells = [3, 1, 1] }
element = "linear"

[groups.tip]
plane = { point = "(60, 0, 0) mm", normal = [1, 0, 0] }

[material]
law = "neo-hookean"
E = "200 kPa"
nu = 0.3
density = "1 g/cm^3"

[[parameters]]
field = "E"
lower = "100 kPa"
upper = "1 MPa"

[markers]
std = "0.1 mm"

[markers.positions]
tip = "(60, 10, 10) mm"
side = { position = "(60, 20, 0) mm", std = "0.2 mm" }
a = "(0, 0, 0) mm"
b = "(0, 20, 0) mm"
c = "(0, 0, 20) mm"

[shared]
gravity = "(0, 0, -9.81) m/s^2"
supports = [{ group = "x_min" }]
markers = ["tip", "side"]

[shared.measured]
file = "markers.csv"
select = { phase = "loaded" }
displacement_from = { phase = "rest" }
registration = { markers = ["a", "b", "c"], select = { phase = "rest" } }

[[configurations]]
name = "weight"
measured.recording = { run = "weight" }

[[configurations]]
name = "pulled"
role = "validation"
loads = [{ surface = "x_max", force = "(20, 0, -50) mN" }]
measured.recording = { run = "pulled" }
"""

MARKERS = """\
run,phase,marker,x_mm,y_mm,z_mm
weight,rest,tip,124.534889729,-161.783369386,441.934810486
weight,rest,side,120.517298587,-150.331950976,433.348543669
weight,rest,a,100.000000000,-200.000000000,400.000000000
weight,rest,b,85.106795208,-186.722970986,401.383094931
weight,rest,c,93.765434083,-208.750734368,416.868753239
weight,loaded,tip,124.627615364,-161.474133460,441.464711016
weight,loaded,side,120.533642034,-150.096862513,432.813597605
weight,loaded,a,100.000000000,-200.000000000,400.000000000
weight,loaded,b,85.106795208,-186.722970986,401.383094931
weight,loaded,c,93.765434083,-208.750734368,416.868753239
pulled,rest,tip,124.534889729,-161.783369386,441.934810486
pulled,rest,side,120.517298587,-150.331950976,433.348543669
pulled,rest,a,100.000000000,-200.000000000,400.000000000
pulled,rest,b,85.106795208,-186.722970986,401.383094931
pulled,rest,c,93.765434083,-208.750734368,416.868753239
pulled,loaded,tip,124.677828797,-161.302787715,441.221229955
pulled,loaded,side,120.535876755,-149.973574960,432.529157843
pulled,loaded,a,100.000000000,-200.000000000,400.000000000
pulled,loaded,b,85.106795208,-186.722970986,401.383094931
pulled,loaded,c,93.765434083,-208.750734368,416.868753239
"""


def write_small_project(folder: Path, *changes: tuple[str, str]) -> Path:
    """Writes project and recordings, with pieces of the project file exchanged."""
    text = PROJECT
    for old, new in changes:
        assert text.count(old) == 1, f"{old!r} stands {text.count(old)} times"
        text = text.replace(old, new)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "markers.csv").write_text(MARKERS)
    path = folder / "project.toml"
    path.write_text(text)
    return path


def sha256_of(path) -> str:
    """The hash by which results name a file."""
    return sha256(Path(path).read_bytes()).hexdigest()
