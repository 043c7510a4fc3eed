"""One result of each kind of command, as values to ten digits.

They do not say what is right, as other tests do: they say that a change of shape has
changed no number. Where a number is meant to change,

    python tests/test_golden_results.py

records all of them anew, in a minute.
"""

import contextlib
import io
import json
import re
import tempfile
from pathlib import Path
from typing import Any

import jax
import numpy as np
from small_project import write_small_project

from softcal_jax.cli import main
from softcal_jax.control import follow_trajectory
from softcal_jax.results import load_result

RECORD = Path(__file__).with_suffix(".json")

PUSHED = (
    (
        '[markers]\nstd = "0.1 mm"\n',
        '[actuators.push]\ntype = "point-force"\npoint = "(60, 10, 20) mm"\n'
        'direction = "-z"\n\n[settings]\nnoise = "stated"\n\n[uncertain]\nmesh = 0\n\n'
        '[markers]\nstd = "0.1 mm"\n',
    ),
    ('name = "weight"\n', 'name = "weight"\nactuation = { push = "0 mN" }\n'),
    ("nu = 0.3\n", "nu = 0.4\n"),
)
"""The small project, which a force can push; the robot had 0.3, so errors are left."""

GOAL = """
[[configurations]]
name = "lower"
goal = { tip = "(-, -, 6) mm" }
supports = [{ group = "x_min" }]
actuation = { push = "10 mN" }

[design]
limits = { push = "0 N to 1 N" }
"""

SWEEP = """\
project = "project.toml"
[axes]
"material.nu" = [0.2, 0.35]
"""

VALUES = {
    "calibrate": """
        parameters.value parameters.standard_error parameters.interval.lower
        parameters.interval.upper configurations.rms_before_mm configurations.motion_mm
        configurations.markers.simulated_mm configurations.newton_steps
        configurations.robot.actuators.displacement
        budget.parameters.by_cause budget.errors.deviations
        assessment.predictions.std_mm identifiability.parameters.standard_error
        identifiability.conditioning.singular_values""",
    "identify": """
        identifiability.parameters.standard_error identifiability.directions.ratio
        identifiability.conditioning.singular_values budget.parameters.by_cause
        ranking.candidates.after""",
    "simulate": """
        configurations.markers.simulated_mm configurations.min_det_F
        configurations.largest_displacement_mm configurations.newton_steps""",
    "inverse": """
        points.goals.reached points.actuators.force points.actuators.displacement
        points.steps.size""",
    "design": """
        design.values design.commands design.goals.expected design.expected""",
    "compare": """
        models.held_out_rms_mm models.score models.folds.rms_mm
        differences.difference""",
    "transfer": """
        difference.of_a difference.of_b difference.std_b difference.chi_squared
        motion rms_of_a""",
}
"""Keys of the numbers in the file, or the output, of each command."""


def numbers(content: Any, keys: list[str]) -> list[float]:
    """List the numbers below nested keys, through lists and tables, in their order."""
    if isinstance(content, list):
        return [number for entry in content for number in numbers(entry, keys)]
    if isinstance(content, dict) and keys:
        return numbers(content[keys[0]], keys[1:])
    if isinstance(content, dict):
        return numbers([content[key] for key in sorted(content)], [])
    is_number = isinstance(content, int | float)
    return [float(f"{content:.10g}")] if is_number else []


def golden(folder: Path) -> dict[str, dict[str, list[float]]]:
    """Run all commands in a new folder, and return their values."""
    path = write_small_project(folder, *PUSHED)
    denser = ('density = "1 g/cm^3"', 'density = "1.02 g/cm^3"')
    second = write_small_project(folder / "second", *PUSHED, denser)
    text = path.read_text()
    rival, other, wanted = (folder / f"{name}.toml" for name in ("a", "b", "goal"))
    rival.write_text(text.replace('role = "validation"\n', ""))
    other.write_text(rival.read_text().replace('"neo-hookean"', '"corotational"'))
    readings = text[text.index("[shared.measured]") : text.index("[[configurations]]")]
    unread = text.replace(readings, "").replace("measured.recording", "# ")
    wanted.write_text(unread + GOAL)
    (folder / "sweep.toml").write_text(SWEEP)
    out, posed = folder / "out", ["--configuration", "weight"]
    aim = ["--goal", "tip=(-, -, 6) mm", "--limit", "push=0 N to 1 N"]
    commands = {
        "calibrate": [path, "-o", out, "--no-pictures"],
        "identify": [path],
        "simulate": [path, "--no-pictures", "-o", folder / "forward"],
        "inverse": [out, *posed, *aim, "--no-pictures", "-o", folder / "command"],
        "design": [wanted, "--no-pictures", "-o", folder / "design"],
        "compare": [rival, other],
        "transfer": [out, second],
        "sweep": [folder / "sweep.toml", "--workers", 1],
    }
    found = {}
    for command, words in commands.items():
        said = io.StringIO()
        with contextlib.redirect_stdout(said):
            code = main([command, *map(str, words), "--json"])
        assert code == 0, f"{command} ended with {code}: {said.getvalue()}"
        if command == "sweep":  # a line of JSON for each trial
            trials = [json.loads(line) for line in said.getvalue().splitlines()]
            keys = sorted(trials[0]["figures"])
            columns = {key: [row["figures"][key] for row in trials] for key in keys}
            found[command] = {key: numbers(of, []) for key, of in columns.items()}
            continue
        content = json.loads(said.getvalue())
        keys = VALUES[command].split()
        found[command] = {key: numbers(content, key.split(".")) for key in keys}
    loaded = load_result(out)
    course = follow_trajectory(
        loaded.model,
        loaded.posed("weight")[0],
        [{"tip": [np.nan, np.nan, z]} for z in (8e-3, 7e-3)],
    )
    forces = [point.actuators[0].force for point in course.points]
    found["trajectory"] = {"force": numbers(forces, [])}
    said = io.StringIO()
    with contextlib.redirect_stdout(said):
        assert main(["check", str(path), "--no-pictures", "-q"]) == 0
    described = [float(x) for x in re.findall(r"-?\d+\.?\d*", said.getvalue())]
    found["check"] = {"described": described}
    return found


def test_no_number_has_changed(tmp_path):
    """To seven digits: another processor may round the rest in another way."""
    recorded, found = json.loads(RECORD.read_text()), golden(tmp_path)
    assert found.keys() == recorded.keys()
    for command, values in recorded.items():
        assert found[command].keys() == values.keys()
        for key, value in values.items():
            largest = np.max(np.abs(value), initial=0.0)
            zero = 1e-10 * largest  # to rounding
            got, about = found[command][key], f"{command}: {key}"
            np.testing.assert_allclose(got, value, rtol=1e-7, atol=zero, err_msg=about)


if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    with tempfile.TemporaryDirectory() as name:
        text = json.dumps(golden(Path(name)), indent=1)
    # A list of numbers stands in one line.
    text = re.sub(r"\s+(?=[-\d\]])", " ", text).replace(" ]", "]").replace("[ ", "[")
    RECORD.write_text(f"{text}\n")
