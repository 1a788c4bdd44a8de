"""What a person is shown may be quoted from a file that wants to be more than text."""

from evpinn_ros.common.errors import LONGEST_TEXT, InputError


def test_an_error_is_one_line_that_does_not_speak_to_the_terminal():
    assert str(InputError("a\x1b[2Jb\nc\rd é")) == "a [2Jb c d é"


def test_an_error_is_of_bearable_length():
    assert str(InputError("x" * 10**6)) == "x" * LONGEST_TEXT + "..."
