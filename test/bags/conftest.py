"""Sound MCAP files to be broken, one of each storage."""

from pathlib import Path
import random

import pytest

from test.bags.broken import STORAGES, write_bag


@pytest.fixture(scope="module")
def wholes(tmp_path_factory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("whole")
    for storage in STORAGES:
        write_bag(folder / f"{storage}.mcap", storage, 120_000, random.Random(7))
    return {storage: folder / f"{storage}.mcap" for storage in STORAGES}
