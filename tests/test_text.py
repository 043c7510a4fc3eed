"""Text of others on its way to a terminal or a spreadsheet."""

import pytest

from softcal_jax._text import as_cell, check_characters, escaped, from_cell, shortened


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("Spitze ü 漢 °", "Spitze ü 漢 °"),
        ("a \u200c joiner, as Persian has it", "a \u200c joiner, as Persian has it"),
        ("two\nlines\tand a tab", "two\nlines\tand a tab"),
        ("\x1b[2Jgone", r"\x1b[2Jgone"),
        ("a\rb\x00\x9b", r"a\rb\x00\x9b"),
        ("left \u202eto right", r"left \u202eto right"),
        ("a name that is not UTF-8: \udcff", r"a name that is not UTF-8: \udcff"),
    ],
)
def test_control_characters_are_shown_and_not_obeyed(text, shown):
    assert escaped(text) == shown


def test_a_control_character_is_refused_by_name():
    check_characters("plain ü\tand\nlines")
    with pytest.raises(ValueError, match=r"'\\x1b'"):
        check_characters("\x1b[31m")


def test_messages_do_not_repeat_a_whole_file():
    assert shortened("x" * 200) == "x" * 200
    assert shortened("x" * 201) == "x" * 200 + "..."


@pytest.mark.parametrize(
    "text", ["=1+1", "+tip", "-tip", "@SUM(A1)", "\t=1", "\r=1", "-1 kPa", "--1"]
)
def test_no_cell_is_a_formula_and_our_reader_gives_the_text_back(text):
    assert as_cell(text) == f"'{text}"
    assert from_cell(as_cell(text)) == text


@pytest.mark.parametrize(
    "text", ["-1", "+2.5", "-1.5e-3", "-.5", "tip", "", "'", "'tip", "a=b", "1-2"]
)
def test_numbers_and_plain_names_stay(text):
    assert as_cell(text) == text
    assert from_cell(text) == text
