import re

from softcal_jax.results import file_stems


def test_plain_names_stay():
    assert file_stems(["gravity", "load-1.5", "a_b"]) == ["gravity", "load-1.5", "a_b"]


def test_nothing_leads_out_of_the_folder():
    names = ["../../etc/passwd", "a b/c", "..", "", "ü", ".hidden", "x" * 300]
    stems = file_stems(names)
    assert stems[:2] == ["etc_passwd", "a_b_c"]
    assert stems[2:5] == ["configuration", "configuration_2", "configuration_3"]
    assert stems[5] == "hidden"
    assert all(re.fullmatch(r"[A-Za-z0-9_-][A-Za-z0-9._-]{0,85}", s) for s in stems)


def test_no_name_is_a_device_of_windows():
    names = ["CON", "nul", "com1.left", "LPT9", "console", "com", "Aux."]
    assert file_stems(names) == [
        *("configuration_CON", "configuration_nul", "configuration_com1.left"),
        *("configuration_LPT9", "console", "com", "configuration_Aux"),
    ]


def test_no_two_configurations_share_a_file():
    # Case does not count on macOS and Windows.
    assert file_stems(["a b", "a/b", "A_B"]) == ["a_b", "a_b_2", "A_B_3"]


def test_the_file_of_a_robot_is_no_other_configurations():
    """ "a" writes a.vtu, and a_robot.vtu for its cables and rigid bodies."""
    assert file_stems(["a", "a_robot"]) == ["a", "a_robot_2"]
    assert file_stems(["A_robot", "a"]) == ["A_robot", "a_2"]


def test_the_other_files_of_the_folder_are_safe():
    taken = file_stems(["markers", "Result", "report"])
    assert taken == ["markers_2", "Result_2", "report_2"]
