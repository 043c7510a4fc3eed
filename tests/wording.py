"""What a message must hold: its values, its names and the key word of its remedy."""

import re


def says(text: object, *parts: str) -> bool:
    """Whether a text holds these parts in this order, however it words the rest.

    A part is looked for as whole words and whole numbers, and where lines break does
    not matter.

    Args:
        text: What prints as a text, or a list or tuple of such, one of which must hold
            all the parts.
        parts: What the reader needs of it. "..." stands for any words.

    Returns:
        True.

    Raises:
        AssertionError: If no text does. It shows what was looked for and where.
    """
    texts = list(map(str, text)) if type(text) in (list, tuple) else [str(text)]
    if not any(re.search(saying(*parts), shown) for shown in texts):
        lines = "\n".join(texts)
        raise AssertionError(f"nothing says {' ... '.join(parts)!r} here:\n{lines}")
    return True


def saying(*parts: str) -> str:
    """The pattern of a text that `says` these parts, for `pytest.raises(match=...)`."""
    return "(?s)" + ".*?".join(map(_whole, " ... ".join(parts).split(" ... ")))


def _whole(part: str) -> str:
    """The pattern of a part that is not the piece of a longer word or number."""
    before = r"(?<!\w)(?<!\d\.)" if re.match(r"\w", part) else ""
    after = r"(?!\w|\.\d)" if re.search(r"\w$", part) else ""
    return before + r"\s+".join(map(re.escape, part.split())) + after
