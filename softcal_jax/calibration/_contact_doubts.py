"""Where contact at a calibrated pose is not what the model takes it for."""

from collections.abc import Iterator, Sequence

from softcal_jax._units import readable
from softcal_jax.calibration._configuration_result import ConfigurationResult
from softcal_jax.contact import Contacts
from softcal_jax.equilibrium import ContactState

SLIDES = 0.05
"""Share of the contact area that may slide, although it is held [-].

A rim of it always slides, since the pressure vanishes there: the outer 5 % of a Hertz
contact bear 1 % of its force.
"""


def contact_doubts(
    contacts: Contacts, fits: Sequence[ConfigurationResult]
) -> tuple[str, ...]:
    """Name the poses where much slides that is held, or the cushion gives way."""
    felt = (
        (f'"{fit.name}"', contact)
        for fit in fits
        if fit.robot is not None
        for contact in fit.robot.contacts
    )
    return tuple(doubt for pose in felt for doubt in _doubts(contacts, *pose))


def _doubts(contacts: Contacts, pose: str, contact: ContactState) -> Iterator[str]:
    if contact.sliding > SLIDES:
        friction = contacts.friction[contacts.names.index(contact.name)]
        yield (
            f'{pose}: {100.0 * contact.sliding:.0f} % of what touches "{contact.name}" '
            f"would slide at the coefficient of friction {friction:g}; it is held as "
            "if it stuck."
        )
    scale, depth = float(contacts.scale), float(contact.depth)
    if depth > scale:
        E = readable(float(contacts.stiffness), "Pa")
        yield (
            f"{pose}: the body lies {readable(depth, 'm')} inside "
            f'"{contact.name}", deeper than the scale of contact, '
            f"{readable(scale, 'm')}: the pressure is more than half of {E}, the "
            "modulus at the start, which contact has. Start with a larger modulus, or "
            "press less."
        )
