"""Fixtures of commands and pages that tests of extras share with those of `cli` and `report`."""

from test.cli.conftest import evpinn, on_a_full_disk  # noqa: F401
from test.report.conftest import browser  # noqa: F401
