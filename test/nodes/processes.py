"""Processes of the tests: none outlives its block, and each ends well when it is told."""

from collections.abc import Iterator
from contextlib import contextmanager
import json
import os
from pathlib import Path
import re
import signal
import subprocess
import sys
import sysconfig
from typing import Any

from evpinn_ros.topics import Topic
from test.conftest import ROOT
from test.waiting import HANG_S

ALL_IN_ONE = """
import json, sys
from pathlib import Path
from evpinn_ros.nodes.all_in_one import run
parameters, record = sys.argv[1:]
raise SystemExit(run(json.loads(parameters), record=Path(record)))
"""
EVPINN = (sys.executable, "-m", "evpinn_ros")
# What a node says that has saved and that Fast DDS holds while it leaves (its issue 6502, see
# docs/project/compatibility.md): it ends with 1 after 8 s. A hang elsewhere is a fault of ours.
HELD = re.compile(
    r"Timeout \(0:00:08\)!\n(?:\[[\w-]+\] )?Thread [^\n]*\n"
    r"(?:\[[\w-]+\] )?  File \"[^\"\n]*/rclpy/publisher\.py\", line \d+ in destroy"
)


def add_messages(environment: dict[str, str]) -> bool:
    """Let processes find the messages that are no wheels; False where they are not built.

    `make test` builds them where a compiler is; EVPINN_MSGS names another folder they are in.
    """
    prefix = Path(environment.get("EVPINN_MSGS", Path(sys.prefix, "msgs")))
    package = Path(sysconfig.get_path("purelib", vars={"base": str(prefix)}))
    folders = {"PYTHONPATH": package, "LD_LIBRARY_PATH": prefix / "lib"}
    folders["AMENT_PREFIX_PATH"] = prefix
    if not (package / "can_msgs").is_dir():
        return False
    for name, folder in folders.items():
        environment[name] = os.pathsep.join((str(folder), environment.get(name, sys.prefix)))
    return True


@contextmanager
def started(*command: object, **options: Any) -> Iterator[subprocess.Popen[str]]:
    """A process with pipes in the root of the checkout; `options` are those of Popen."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True, "cwd": ROOT}
    process = subprocess.Popen([*map(str, command)], **{**pipes, **options})
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


def stopped(process: subprocess.Popen[str], by: signal.Signals = signal.SIGINT) -> tuple[str, str]:
    """What a process still writes, to stdout and stderr, that must end well by a signal."""
    process.send_signal(by)
    out, said = process.communicate(timeout=HANG_S)
    assert process.returncode == int(bool(HELD.search(said))), said
    assert "Traceback" not in said, said
    return out, said


def await_line(process: subprocess.Popen[str], pattern: str) -> str:
    """Read stderr up to a line with this pattern; gives what fits."""
    said: list[str] = []
    while not (matched := re.search(pattern, said[-1] if said else "")):
        said.append(process.stderr.readline())
        assert said[-1], "".join(said)
    return matched[0]


def node(name: str, *deep: Topic, **parameters: object) -> tuple[str, ...]:
    """The command of a node under /ev, with deep queues for some of its inputs."""
    queues = {f"qos_overrides.{topic.under()}.subscription.depth": 1000 for topic in deep}
    values = {"vehicle": "tesla_model_3_lr", **queues, **parameters}
    options = [word for k, v in values.items() for word in ("-p", f"{k}:={json.dumps(v)}")]
    executable = (sys.executable, "-m", "evpinn_ros.executables", name)
    return *executable, "--ros-args", "-r", "__ns:=/ev", *options


def all_in_one(bag: Path, **parameters: object) -> tuple[object, ...]:
    """The command of the three nodes in one process, which record a bag."""
    values = {"vehicle": "tesla_model_3_lr", **parameters}
    return sys.executable, "-c", ALL_IN_ONE, json.dumps(values), bag
