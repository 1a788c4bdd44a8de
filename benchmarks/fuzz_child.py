"""One target under atheris, in a process of its own, which libFuzzer ends: `python -m` this."""

from __future__ import annotations

import json
from pathlib import Path
from random import Random
import sys
from tempfile import TemporaryDirectory
import time

# What libFuzzer shall see the inside of: us, and the parsers in Python that we stand on.
INSTRUMENTED = [
    *("evpinn_ros.bags", "evpinn_ros.can", "evpinn_ros.nodes", "evpinn_ros.common.yaml_section"),
    *("evpinn_ros.core.vehicle", "evpinn_ros.common.saved_fields"),
    *("can.io", "cantools", "textparser", "mcap", "rosbags", "yaml", "isotp"),
]


def main() -> None:
    """Fuzz the target named first; the second names the file for what was measured."""
    import atheris  # of the extra `fuzz`, which nothing else needs

    name, result = sys.argv[1], Path(sys.argv[2])
    with atheris.instrument_imports(include=INSTRUMENTED):
        # Here and not at the top: what is imported before it is not instrumented.
        from benchmarks.fuzz_targets import TARGETS
    target = next(each for each in TARGETS if each.name == name)
    with TemporaryDirectory() as folder:
        target.beside(Path(folder))
        slowest = 0.0

        def one(data: bytes) -> None:
            nonlocal slowest
            begin = time.perf_counter()
            target.run(Path(folder), data)
            took = time.perf_counter() - begin
            if took > slowest:
                slowest = took
                result.write_text(json.dumps({"slowest_s": slowest}))

        def damaged(data: bytes, most: int, seed: int) -> bytes:
            """Half of the inputs keep their structure; no input is longer than `most`."""
            chance = Random(seed)
            if target.mutate is None or chance.randrange(2):
                return bytes(atheris.Mutate(data, most))
            return target.mutate(data, chance)[:most]

        atheris.Setup([sys.argv[0], *sys.argv[3:]], one, custom_mutator=damaged)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
