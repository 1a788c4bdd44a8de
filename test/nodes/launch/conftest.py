"""The real `ros2` command line and `launch`: of a sourced ROS 2, or of ../shared/ros2_tools.

`make test` installs the latter into a folder beside its environment; EVPINN_ROS2_TOOLS names
another. Without either these tests are skipped.
"""

from collections.abc import Iterator
from contextlib import contextmanager
import importlib.util
import json
import os
from pathlib import Path
import re
import shutil
import signal
import subprocess
import sys
import sysconfig

import pytest

from test.nodes.processes import HELD, add_messages, started
from test.waiting import HANG_S, wait_until

STAND_IN = Path(__file__).with_name("ros2_bag.py")
DAEMON = """
import rclpy
from ros2cli.daemon import main
rmw = rclpy.get_rmw_implementation_identifier()
main(argv=["--rmw-implementation", rmw, "--ros-domain-id", "{domain}", "--timeout", "600"])
"""
COMMAND = """#!/bin/sh
test "$1" = bag && exec "{python}" "{stand_in}" "$@"
exec "{python}" -c 'import sys; from ros2cli.cli import main; sys.exit(main())' "$@"
"""
ONE_AFTER_THE_OTHER = """
import json, sys
from ros2cli.cli import main
for words in json.loads(sys.argv[1]):
    try:
        code = main(argv=words)
    except SystemExit as ended:
        code = ended.code
    print(f"\\n=== ended with {code or 0}", flush=True)
"""


class Ros2:
    """Runs the command `ros2` in a workspace that holds this package."""

    def __init__(self, environment: dict[str, str], folder: Path) -> None:
        self.environment, self.folder = environment, folder

    def run(self, *words: object) -> str:
        """What a command that ends by itself prints."""
        return self._said(self._command(words))

    def _said(self, command: list[str], timeout: float = HANG_S) -> str:
        return subprocess.run(
            command, cwd=self.folder, env=self.environment, text=True, timeout=timeout,
            stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ).stdout  # fmt: skip

    def run_all(self, *commands: tuple[object, ...]) -> list[tuple[int, str]]:
        """Exit code and output of each, in one process: to start one for each takes seconds."""
        words = json.dumps([[str(word) for word in command] for command in commands])
        all_said = self._said([sys.executable, "-c", ONE_AFTER_THE_OTHER, words])
        parts = re.split(r"^=== ended with (\d+)$", all_said, flags=re.M)
        assert len(parts) == 2 * len(commands) + 1, all_said
        return [(int(code), said) for said, code in zip(parts[::2], parts[1::2], strict=False)]

    def ask(self, *words: object) -> str:
        """What a command prints that asks the graph, once it has found the node.

        The daemon can lose a node (people then stop it), and a command waits for ever for an
        answer that was sent before DDS had matched it with the node; then another one asks,
        without the daemon.
        """
        tried: list[str] = []

        def answer() -> str:
            alone = ("--no-daemon",) if tried else ()
            try:
                tried.append(self._said(self._command((*words, *alone)), HANG_S / 4))
            except subprocess.TimeoutExpired:
                tried.append("")
            return "" if tried[-1].strip() == "Node not found" else tried[-1]

        return wait_until(answer, report=lambda: (words, tried))

    @contextmanager
    def running(self, *words: object) -> Iterator["Running"]:
        """A command that is stopped by SIGINT in the end, and must then end well."""
        log = self.folder / f"{words[0]}_{os.urandom(4).hex()}.log"
        with log.open("w") as output:
            process = subprocess.Popen(
                self._command(words), cwd=self.folder, env=self.environment,
                stdin=subprocess.DEVNULL, stdout=output, stderr=subprocess.STDOUT,
                start_new_session=True,
            )  # fmt: skip
        running = Running(process, log)
        try:
            yield running
            running.stop()
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def _command(self, words: tuple[object, ...]) -> list[str]:
        command = shutil.which("ros2", path=self.environment["PATH"])
        assert command is not None
        return [command, *map(str, words)]


class Running:
    """A command that runs, and what it has written so far.

    Attributes:
        killed: of its processes, those that a test killed.
        codes: with which it may end.
        theirs: what it prints that is none of ours, left out before tracebacks are looked for.
    """

    def __init__(self, process: subprocess.Popen[bytes], log: Path) -> None:
        self.process, self._log, self.killed, self.codes = process, log, 0, {0}
        self.theirs = re.compile("(?!)")

    @property
    def output(self) -> str:
        return self._log.read_text(errors="replace")

    def stop(self) -> None:
        """As Ctrl-C does, which reaches the whole group; each process must end cleanly."""
        if self.process.poll() is None:
            os.killpg(self.process.pid, signal.SIGINT)
        code = self.process.wait(HANG_S)
        assert code in self.codes, self.output
        died = self.killed + len(HELD.findall(self.output))
        assert self.output.count("process has died") == died, self.output
        assert "Traceback" not in self.theirs.sub("", self.output), self.output


def tools() -> Path | None:
    """Where `launch` and `ros2cli` were installed for tests."""
    prefix = Path(os.environ.get("EVPINN_ROS2_TOOLS", Path(sys.prefix, "ros2")))
    packages = Path(sysconfig.get_path("purelib", vars={"base": str(prefix)}))
    return packages if (packages / "ros2launch").is_dir() else None


@pytest.fixture(scope="session")
def ros2(installed: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Ros2]:
    """The command line, with this package installed by colcon."""
    folder, plugins = tmp_path_factory.mktemp("ros2"), tools()
    sourced = shutil.which("ros2") and importlib.util.find_spec("ros2launch")
    if plugins is None and not sourced:
        pytest.skip("neither ../shared/ros2_tools nor a sourced ROS 2 is here")
    prefix = installed / "evpinn_ros"
    package = sysconfig.get_path("purelib", vars={"base": str(prefix)})
    paths = {
        "AMENT_PREFIX_PATH": [prefix, os.environ.get("AMENT_PREFIX_PATH", sys.prefix)],
        "PYTHONPATH": [package, *([plugins] if plugins else []), os.environ.get("PYTHONPATH", "")],
        # Scripts begin with `env python3`: that of this environment.
        "PATH": [folder / "bin", Path(sys.executable).parent, os.environ["PATH"]],
    }
    (folder / "bin").mkdir()
    if plugins is not None:
        command = folder / "bin" / "ros2"
        command.write_text(COMMAND.format(python=sys.executable, stand_in=STAND_IN))
        command.chmod(0o755)
    joined = {name: os.pathsep.join(map(str, parts)) for name, parts in paths.items()}
    joined["PYTHONUNBUFFERED"] = "1"  # what is printed into a file can be read at once
    environment = {**os.environ, **joined, "ROS_LOG_DIR": str(folder / "log")}
    add_messages(environment)
    with _daemon(environment, folder / "daemon.log"):
        yield Ros2(environment, folder)


@contextmanager
def _daemon(environment: dict[str, str], log: Path) -> Iterator[None]:
    """The daemon of the command line: it knows the graph, so no command looks around for seconds.

    The real one, but a child of this process and not left behind.
    """
    code = DAEMON.format(domain=environment["ROS_DOMAIN_ID"])
    command = (sys.executable, "-c", code)
    options = {"env": environment, "stdin": subprocess.DEVNULL, "stderr": subprocess.STDOUT}
    with log.open("w") as output, started(*command, stdout=output, **options) as daemon:
        wait_until(lambda: "Serving" in log.read_text() or daemon.poll() is not None)
        assert daemon.poll() is None, log.read_text()
        yield
