from test.cli.conftest import evpinn  # noqa: F401
