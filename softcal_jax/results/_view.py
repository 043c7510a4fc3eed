"""The view of a page: the body in three dimensions, as far as the browser draws it."""

import json
from collections.abc import Iterable, Mapping, Sequence, Set
from typing import Any, NamedTuple

from softcal_jax.calibration import (
    CalibrationResult,
    ConfigurationResult,
    SimulationResult,
)
from softcal_jax.equilibrium import Model
from softcal_jax.mesh import PARTS, boundary_tets
from softcal_jax.plotting import LABELS, MARKS, NOT_CONVERGED, motion_words
from softcal_jax.results._html import Html, bullets, joined, node, resource, template
from softcal_jax.results._outline import ROLES
from softcal_jax.results._view_data import (
    TetValues,
    calibrated_field,
    state_fields,
    surface_of,
    view_data,
    view_fields,
)

MOST_DATA = 1_500_000  # bytes of what a view draws; curved faces are cut more coarsely
_SHOWN = {
    "mesh": ("faces of the mesh", False),
    "rest": ("body at rest", True),
    "markers": ("markers", True),
    "robot": ("cables, walls, motors", True),
    "obstacles": ("obstacles", True),
    "loads": ("loads and gravity", True),
    "frames": ("frames", True),
    "fibres": ("fibres", False),
    "names": ("names", True),
}
"""What can be shown, by its name in the script, and whether it is shown at first."""

_LINE = '<path d="M2 7H26" stroke="{0}" stroke-width="2.5"/>'
_DASHED = _LINE.replace("/>", ' stroke-dasharray="7 3 2 3"/>')
_ARROW = '<path d="M2 7H20M26 7L17 2V12Z" stroke="{0}" fill="{0}" stroke-width="2"/>'
_PATCH = '<rect x="4" y="2" width="20" height="10" fill="{0}"/>'
_PALE = _PATCH.replace("/>", ' opacity=".4"/>')
_CIRCLE = '<circle cx="14" cy="7" r="5" fill="none" stroke="{0}" stroke-width="2.2"/>'
_CROSS = '<path d="M14 1V13M8 7H20" stroke="{0}" stroke-width="2.2"/>'
_HATCH = '<path d="M3 12L13 2M14 12L24 2" stroke="{0}" stroke-width="2"/>'
_AXES = (
    '<path d="M14 13V2M14 13H25M14 13L6 8" fill="none" stroke="{0}" '
    'stroke-width="2" stroke-dasharray="3 2"/>'
)

# The symbol of each mark of the legend, to be coloured by `MARKS`, and the boxes of
# `_SHOWN` of which one must be ticked: none for a mark that is always shown.
_SYMBOLS = {
    "measured": (_CIRCLE, "markers frames"),
    "simulated": (_CROSS, "markers frames"),
    "at rest": (_LINE, "rest"),
    "cable": (_LINE, "robot"),
    "wall under pressure": (_PALE, "robot"),
    "motor": (_DASHED, "robot"),
    "force": (_ARROW, "robot"),
    "load": (_ARROW, "loads"),
    "gravity": (_ARROW, "loads"),
    "rigid body": (_PATCH, ""),
    "obstacle": (_PALE, "obstacles"),
    "frame of a rigid body": (_AXES, "frames"),
    "fibre": (_HATCH, "fibres"),
}


class PageView(NamedTuple):
    """What a page needs to draw a body: HTML, hidden until its script runs.

    `names` are those of the configurations that are drawn in equilibrium.
    """

    content: Html
    script: str
    names: frozenset[str]

    @property
    def size(self) -> int:
        """How many bytes it adds to a page."""
        return len(self.content.encode()) + len(self.script.encode())


class _Drawing(NamedTuple):
    """What is drawn, also as JSON, its configurations, and what was cut to fit.

    It is coloured by the field with the index `field` at first.
    """

    data: dict[str, Any]
    text: str
    shown: Sequence[ConfigurationResult]
    remarks: Sequence[str]
    field: int


def body_view(
    result: CalibrationResult | SimulationResult, errors: TetValues | None
) -> PageView:
    """Make the view of all configurations of a result, hidden until its script runs.

    What is too large for a page is drawn more coarsely or left out, and the view says
    so: first curved faces get fewer triangles, then the last configurations go.
    """
    drawing, why = None, "no configuration has an equilibrium"
    if any(pose.converged for pose in result.configurations):
        drawing = _drawing(result.model, result.configurations, errors)
        n = len(boundary_tets(result.model.mesh))
        why = f"the surface of this mesh, {n} faces, is too large for a page; "
        why += "configurations.pvd is for ParaView"
    if drawing is None:
        return PageView(node("p", f"No 3-D view: {why}."), "", frozenset())
    trusted = not isinstance(result, CalibrationResult) or result.converged
    marks, fields = _marks(drawing.data), drawing.data["fields"]
    words = [
        node("p", _words(pose), hidden="", class_="" if pose.converged else "stop")
        for pose in drawing.shown
    ]
    figure = template(
        "view.html",
        warning=[] if trusted else [node("p", NOT_CONVERGED, class_="stop")],
        choices=_choices(drawing, marks),
        coloured=f"Colours of {fields[0]['label']}" if fields else "Colours",
        legend=_legend(marks, {pose.role for pose in drawing.shown}),
        words=words,
        remarks=bullets(drawing.remarks),
    )
    text = Html(drawing.text)
    data = node("script", text, type="application/json", id="view-data")
    names = frozenset(pose.name for pose in drawing.shown if pose.converged)
    return PageView(joined([figure, data]), resource("view.js"), names)


def _drawing(
    model: Model, every: Sequence[ConfigurationResult], errors: TetValues | None
) -> _Drawing | None:
    """Collect what is drawn, as finely as fits; None if nothing fits.

    Where not all configurations fit, those without an equilibrium go first.
    """
    states = [state_fields(model, pose) for pose in every]
    parts, kept = PARTS if model.mesh.order == 2 else 1, list(range(len(every)))
    while kept:
        shown, surface = [every[k] for k in kept], surface_of(model, parts)
        fields = view_fields(model, shown, [states[k] for k in kept], surface, errors)
        data = view_data(model, shown, surface, fields) | {"colours": MARKS}
        # "<" must not end the element that the data are in.
        text = json.dumps(data, allow_nan=False, separators=(",", ":"))
        text = text.replace("<", "\\u003c")
        if len(text) <= MOST_DATA:
            remarks = []
            if model.mesh.order == 2 and parts < PARTS:
                remarks.append(
                    "Curved faces are drawn coarsely, to keep the page small."
                )
            left_out = [pose.name for k, pose in enumerate(every) if k not in kept]
            if left_out:
                remarks.append(
                    f"Left out to keep the page small: {', '.join(left_out)}."
                )
            return _Drawing(data, text, shown, remarks, calibrated_field(fields))
        if parts > 1:
            parts //= 2
        elif not all(pose.converged for pose in shown):
            kept = [k for k in kept if every[k].converged]
        else:  # the size is nearly proportional to the number of configurations
            most = len(kept) * MOST_DATA // len(text) + 1
            kept = kept[: min(len(kept) - 1, most)]
    return None


def _words(pose: ConfigurationResult) -> str:
    """Say what a configuration shows."""
    if not pose.converged:
        why = f"no equilibrium ({pose.outcome})"
        return f"{pose.name}: {why}. The body is drawn at rest."
    return f"{_named(pose)}: {motion_words(pose)}."


def _named(pose: ConfigurationResult) -> str:
    role = "" if pose.role == "simulation" else f" ({ROLES[pose.role]})"
    return f"{pose.name}{role}" + ("" if pose.converged else " - no equilibrium")


def _choices(drawing: _Drawing, marks: Sequence[str]) -> Html:
    """Write the choices of configuration, field and direction, and what is shown."""
    shown, fields = drawing.shown, drawing.data["fields"]
    poses = drawing.data["configurations"]
    drawn = [k for k, pose in enumerate(shown) if pose.converged]
    first = max(drawn, key=lambda k: shown[k].largest_displacement, default=0)
    directions = ["at an angle", *(f"from {s}{axis}" for axis in "xyz" for s in "+-")]
    offered = {"mesh", "rest", "names"}
    offered |= {k for k in ("markers", "frames") if any(pose[k] for pose in poses)}
    for name in set(marks) - {"measured", "simulated"}:
        offered.update(_SYMBOLS[name][1].split())
    ticks = []
    for name, (words, on) in _SHOWN.items():
        if name in offered:
            checked = {"checked": ""} if on else {}
            box = node("input", type="checkbox", id=f"view-{name}", **checked)
            ticks.append(node("label", box, f" {words}"))
    return node(
        "div",
        _select("configuration", "Configuration", map(_named, shown), first),
        _select("field", "Coloured by", [f["label"] for f in fields], drawing.field),
        _select("direction", "Seen", directions, 0),
        node("fieldset", node("legend", "Show"), *ticks),
        class_="choices",
    )


def _select(key: str, label: str, texts: Iterable[str], chosen: int) -> Html:
    options = (
        node("option", text, value=str(k), **({"selected": ""} if k == chosen else {}))
        for k, text in enumerate(texts)
    )
    return node("label", f"{label} ", node("select", *options, id=f"view-{key}"))


def _marks(data: Mapping[str, Any]) -> list[str]:
    """List the marks that occur in the data, in the order of the legend."""
    poses = data["configurations"]
    keys = {"cable": "cables", "wall under pressure": "walls", "motor": "motors"}
    keys |= {"gravity": "gravity", "fibre": "fibres", "obstacle": "obstacles"}
    present = {mark for mark, key in keys.items() if any(pose[key] for pose in poses)}
    points = [point for pose in poses for point in pose["markers"]]
    present |= {k for k in ("measured", "simulated") if any(p[k] for p in points)}
    parts = [part for pose in poses for part in (*pose["frames"], *pose["arrows"])]
    present |= {part["kind"] for part in parts}
    present |= {"at rest", *(["rigid body"] if data["anyRigid"] else [])}
    return [name for name in _SYMBOLS if name in present]


def _legend(marks: Sequence[str], roles: Set[str]) -> Html:
    """Explain the marks, in the words of the roles of the configurations."""
    labels = LABELS[next(iter(roles & LABELS.keys()), "")]
    called = dict(zip(LABELS[""], labels, strict=True))
    entries = []
    for name in marks:
        symbol, boxes = _SYMBOLS[name]
        drawn = Html(symbol.format(MARKS[name]))
        of = {"data_of": boxes} if boxes else {}
        mark = node("svg", drawn, width="28", height="14", aria_hidden="true")
        entries.append(node("li", mark, called.get(name, name), **of))
    return node("ul", *entries, class_="legend")
