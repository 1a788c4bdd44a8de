"""The command in this process, for the commands of extras."""

from test.cli.conftest import evpinn, on_a_full_disk  # noqa: F401
