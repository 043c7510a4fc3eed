"""Names that a user types."""

from wording import says

from softcal_jax._text import unknown_name


def test_names_with_numbers_are_listed_in_their_order():
    """Faces of a CAD model have numbers, and there may be many."""
    known = ["face 10", "face 2", "base", "face 1"]
    text = str(unknown_name("surface group", "bose", known))
    assert says(text, "surface group 'bose' ", "mean 'base'")
    assert says(text, "'base', 'face 1', 'face 2', 'face 10'")
