"""Axes named by letters."""


def parse_axes(axes: str) -> list[int]:
    """Return the indices of the axes in a word like "xz".

    Raises:
        ValueError: If the word holds anything but x, y and z, each at most once.
    """
    if not axes or set(axes) - set("xyz") or len(set(axes)) != len(axes):
        raise ValueError(
            'axes must be made of the letters x, y, z, like "xyz" or "z", '
            f"got {axes!r}."
        )
    return ["xyz".index(letter) for letter in axes]
