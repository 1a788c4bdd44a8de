"""Readings that were not used, in words, and only those that were lost."""

from evpinn_ros.report.dropped_text import dropped_text


def test_only_what_was_lost_is_said_in_words():
    assert dropped_text({"battery_unmeasured": 1789}) == ""
    lost = {"battery_unmeasured": 1789, "wrong_number_of_cells": 2, "ambient_c_out_of_range": 1}
    assert dropped_text(lost) == "2 incomplete rows, 1 ambient c out of range"
