#!/usr/bin/env bash
# What evpinn_ros needs of Python, beside a sourced ROS 2: a virtual environment over the packages of
# the system, so that rclpy and the messages are those of ROS, and numpy is the one they are built for.
# usage: install_into_ros.sh ENVIRONMENT [EXTRAS]   then: . ENVIRONMENT/bin/activate; python -m colcon build
# EXTRAS of setup.py with commas, as report,tables. PIP_EXTRA_INDEX_URL: PyTorch's CPU builds, without CUDA.
set -euo pipefail
here=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)
environment=$1
package=$here${2:+[$2]}
python3 -c 'import rclpy' || { echo "source ROS 2 first: /opt/ros/.../setup.bash" >&2; exit 1; }
python3 -m venv --system-site-packages "$environment"
touch "$environment/COLCON_IGNORE"
# numpy is the system's; pandas is whichever fits it.
constraints=$environment/constraints.txt
grep -v -e '^numpy' -e '^pandas' -e '^ros-' "$here/constraints.txt" >"$constraints"
python3 -c 'import numpy; print(f"numpy=={numpy.__version__}")' >>"$constraints"
# ROS's colcon where it is, else one here.
colcon=()
python3 -c 'import colcon_ros, colcon_package_selection' 2>/dev/null || colcon=(colcon-common-extensions)
# The package itself is colcon's to build: here it only says what it needs.
"$environment/bin/python" -m pip install --disable-pip-version-check -c "$constraints" "$package" "${colcon[@]}"
"$environment/bin/python" -m pip uninstall -qq -y evpinn_ros
