"""Which keys belong to which type of actuator and effector."""

from typing import Any, NamedTuple


class Keys(NamedTuple):
    """Keys of one type beside `type`.

    Attributes:
        needed: Those that must be there, and what they are, with an example.
        optional: Those that may be there.
    """

    needed: dict[str, str]
    optional: tuple[str, ...] = ()


_BODY = {"body": 'name of a rigid body, [bodies.NAME]: "plate"'}
_ACTUATOR = {"actuator": 'name of an actuator, [actuators.NAME]: "cable"'}
_SURFACE = {"surface": 'name of a surface group: "z_max"'}
_DIRECTION = {"direction": 'direction of a positive force: "-z", or [0, 0, -1]'}
_STD = {"std": 'standard deviation, with the unit of what is measured: "0.1 mm"'}
_GROUP = {"group": 'name of a group of the mesh: "x_min"'}

KINDS = {
    "actuators": {
        "cable": Keys(
            {
                "guides": "the points that it runs through, both ends included: "
                '[{ point = "(0, 10, 0) mm", on = "ground" }, "(50, 10, 0) mm"]'
            }
        ),
        "chamber": Keys({"surface": 'the surface group of its whole wall: "cavity"'}),
        "surface-pressure": Keys(_SURFACE),
        "motor": Keys({"body": 'the rigid body that it turns, with a hinge: "arm"'}),
        "point-force": Keys({"point": 'where it acts: "(50, 10, 0) mm"', **_DIRECTION}),
        "surface-force": Keys({**_SURFACE, **_DIRECTION}),
    },
    "effectors": {
        "frame": Keys(_BODY, ("point", "orientation", "base", "std", "std_angle")),
        "centroid": Keys(_GROUP, ("std",)),
        "angle": Keys(
            {
                **_BODY,
                "other": "the rigid body it is measured from",
                "axis": 'axis of the angle, fixed on `other`: "z", or [0, 0, 1]',
            },
            ("std",),
        ),
        "actuator-displacement": Keys({**_ACTUATOR, **_STD}),
        "actuator-force": Keys({**_ACTUATOR, **_STD}),
        "reaction": Keys(_GROUP, ("std",)),
    },
}
"""Tables of a file, their types, and the keys of these."""


def kind_problems(raw: dict[str, Any]) -> list[str]:
    """Keys that actuators and effectors lack, or that belong to another type.

    Args:
        raw: The file as it was read. What is wrong in itself is not judged here.
    """
    problems = []
    for section, kinds in KINDS.items():
        tables = raw.get(section)
        for name, own in tables.items() if isinstance(tables, dict) else ():
            kind = own.get("type") if isinstance(own, dict) else None
            if isinstance(kind, str) and kind in kinds:
                where = f"{section}.{name}"
                problems += _problems(where, own, kind, kinds)
    return problems


def _problems(
    where: str, own: dict[str, Any], kind: str, kinds: dict[str, Keys]
) -> list[str]:
    keys = kinds[kind]
    known = (*keys.needed, *keys.optional)
    elsewhere = {
        k for other in kinds.values() for k in (*other.needed, *other.optional)
    }
    problems = [
        f"{where}.{key}: missing. Expected {words}."
        for key, words in keys.needed.items()
        if key not in own
    ]
    return problems + [
        f'{where}.{key}: type = "{kind}" has no {key}; it has {", ".join(known)}.'
        for key in own
        if key in elsewhere and key not in known
    ]
