"""Build wheel and sdist, and install both in a fresh environment of each Python that is given.

    python test/wheels.py python3.10 python3.13 --without torch

Both pass `twine check`. In each environment: the requirements at the versions of constraints.txt,
`pip check`, the wheel and then the sdist, every module compiled and imported, and commands run
away from the checkout.
What is left out by `--without`, as PyTorch is gigabytes, may be missed by modules that need it.
"""

import argparse
from email import message_from_bytes
import os
from pathlib import Path
import re
import subprocess
import sys
from tempfile import TemporaryDirectory
from xml.etree import ElementTree
from zipfile import ZipFile

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = ElementTree.parse(ROOT / "package.xml")
# Of ROS 2 and of extras: what needs them is not imported without.
OPTIONAL = {"ament_index_python", "extras"} | {tag.text for tag in MANIFEST.iter("exec_depend")}

IMPORT_ALL = """
import importlib, pathlib, sys
import evpinn_ros
from evpinn_ros.common.errors import InputError
package = pathlib.Path(evpinn_ros.__file__).parent
missed, count = {}, 0
for path in sorted(package.rglob("*.py")):
    parts = [p for p in path.relative_to(package.parent).with_suffix("").parts if p != "__init__"]
    if parts[-1] == "__main__":
        continue
    try:
        importlib.import_module(".".join(parts))
        count += 1
    except ModuleNotFoundError as error:
        missed.setdefault(error.name.partition(".")[0], []).append(".".join(parts))
    except InputError:
        missed.setdefault("extras", []).append(".".join(parts))
print(count, *(f"{name}:{len(modules)}" for name, modules in sorted(missed.items())))
"""


def run(*command: object, cwd: Path | None = None) -> str:
    environment = {k: v for k, v in os.environ.items() if k != "PYTHONPATH"}
    words = [str(word) for word in command]
    ended = subprocess.run(words, cwd=cwd, env=environment, capture_output=True, text=True)
    if ended.returncode:
        sys.exit(f"{' '.join(words)}\n{ended.stdout}{ended.stderr}")
    return ended.stdout.strip()


def build(folder: Path) -> tuple[Path, Path]:
    """The sdist of the checkout, and the wheel made of that sdist."""
    run(sys.executable, "-m", "venv", folder / "build")
    python = folder / "build" / "bin" / "python"
    run(python, "-m", "pip", "install", "-qq", "build", "twine")
    run(python, "-m", "build", "--outdir", folder / "dist", ROOT)
    (sdist,) = (folder / "dist").glob("*.tar.gz")
    (wheel,) = (folder / "dist").glob("*.whl")
    run(python, "-m", "twine", "check", "--strict", sdist, wheel)
    tracked = run("git", "ls-files", "evpinn_ros", "config", "launch", "bags", cwd=ROOT)
    data = f"{wheel.name.rpartition('-py3')[0]}.data/data/share/evpinn_ros/"
    held = {name.removeprefix(data) for name in ZipFile(wheel).namelist()}
    missing = set(tracked.splitlines()) - held
    if missing:
        sys.exit(f"the wheel made of the sdist lacks {sorted(missing)}")
    return sdist, wheel


def requirements(wheel: Path, without: set[str]) -> list[str]:
    archive = ZipFile(wheel)
    (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
    lines = message_from_bytes(archive.read(name)).get_all("Requires-Dist")
    needed = [line for line in lines if "extra ==" not in line]
    return [line for line in needed if re.match(r"[\w-]+", line)[0] not in without]


def try_python(python: str, sdist: Path, wheel: Path, without: set[str], folder: Path) -> str:
    home = folder / Path(python).resolve().parents[1].name
    run(python, "-m", "venv", home)
    pip = (home / "bin" / "python", "-m", "pip", "--disable-pip-version-check")
    constraints = ("-c", ROOT / "constraints.txt")
    run(*pip, "install", "-qq", *constraints, *requirements(wheel, without))
    run(*pip, "install", "-qq", "--no-deps", wheel)
    result = tell_of(home, folder, without)
    run(*pip, "install", "-qq", "--no-deps", "--force-reinstall", sdist)
    if tell_of(home, folder, without) != result:
        sys.exit(f"{python}: wheel and sdist differ")
    return result


def tell_of(home: Path, folder: Path, without: set[str]) -> str:
    """What works in an environment; ends the script when anything does not that should."""
    python = home / "bin" / "python"
    check = subprocess.run([python, "-m", "pip", "check"], capture_output=True, text=True).stdout
    lacking = set(re.findall(r"requires ([\w-]+), which is not installed", check))
    if lacking != without or "incompatible" in check:
        sys.exit(check)
    package = run(python, "-c", "import evpinn_ros; print(evpinn_ros.__path__[0])", cwd=folder)
    run(python, "-W", "error", "-m", "compileall", "-q", "-f", package)
    count, *missed = run(python, "-c", IMPORT_ALL, cwd=folder).split()
    unexpected = {name.partition(":")[0] for name in missed} - without - OPTIONAL
    if unexpected:
        sys.exit(f"{home.name}: cannot import {unexpected}")
    evpinn = home / "bin" / "evpinn"
    urban = home / "share" / "evpinn_ros" / "bags" / "urban"
    version = run(evpinn, "--version", cwd=folder)
    run(evpinn, "check-params", home / "share/evpinn_ros/config/vehicles/generic.yaml", cwd=folder)
    with TemporaryDirectory() as new:
        if "torch" not in without:
            run(evpinn, "--help", cwd=folder)
            run(evpinn, "replay", urban, "--vehicle", "tesla_model_3_lr", "--out", f"{new}/out")
    python_version = run(python, "-c", "import platform; print(platform.python_version())")
    return f"Python {python_version}: evpinn {version}, {count} modules; not: {' '.join(missed)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("pythons", nargs="+", help="interpreters")
    parser.add_argument("--without", nargs="*", default=[], help="requirements to leave out")
    given = parser.parse_args()
    with TemporaryDirectory() as folder:
        sdist, wheel = build(Path(folder))
        print(f"{sdist.name}, and of it {wheel.name}", flush=True)
        for python in given.pythons:
            result = try_python(python, sdist, wheel, set(given.without), Path(folder))
            print(result, flush=True)


if __name__ == "__main__":
    main()
