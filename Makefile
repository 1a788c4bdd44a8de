# `make demo` and `make test` need python3 with its venv module, and the package index.
PYTHON ?= python3
PYTHON312 ?= python3.12
CONSTRAINTS ?= constraints.txt
# More than cores: tests of nodes and buses wait most of the time.
JOBS ?= 3
CHOSEN ?= not nightly
IN_PARALLEL := -n $(JOBS) --dist loadfile --no-loadscope-reorder
VENV := .venv
BIN := $(VENV)/bin
EVPINN := $(BIN)/evpinn
INSTALLED := $(VENV)/installed

# A sourced ROS 2 brings its own rclpy; without one it comes as wheels, with the extra `ros`.
ifdef ROS_DISTRO
VENV_OPTIONS := --system-site-packages
DEMO_EXTRAS := report,tables
else
DEMO_EXTRAS := ros,report,tables
endif
EXTRAS := $(DEMO_EXTRAS),dev,bench,fleet,site

# `make demo` runs with all of the environment where there is one, else with what a user installs.
DEMO := $(or $(wildcard $(INSTALLED)),$(VENV)/demo)

# Nodes started here meet no other robot, and workers side by side take one core each.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID := 86
export OMP_NUM_THREADS := 1
# Else each process that a test starts compiles the package again, for seconds.
unexport PYTHONDONTWRITEBYTECODE

# The real `launch` and `ros2`, where they lie and no ROS 2 is sourced, in a folder of their own:
# among the other packages their plugins would change pytest. Tests of launch files use them.
ROS2_TOOLS ?= ../shared/ros2_tools
ifeq ($(ROS_DISTRO)$(wildcard $(ROS2_TOOLS)/install.sh),$(ROS2_TOOLS)/install.sh)
ROS2_INSTALLED := $(VENV)/ros2/installed
endif

# The typed messages, where a compiler is: built against the wheels, or by whoever sourced ROS 2.
MSGS := $(VENV)/msgs
ifeq ($(ROS_DISTRO),)
ifneq ($(and $(shell command -v c++),$(shell command -v cmake)),)
MSGS_INSTALLED := $(MSGS)/installed
endif
endif

# What tests load, compiled once: else all workers compile the same modules at the same time.
COMPILED := $(VENV)/compiled

# What `make core` runs with: all of the environment where there is one, else what the core needs.
ROOMS := test/core/signals test/core/estimation test/core/energy
CORE_VENV := .venv-core
CORE := $(or $(wildcard $(INSTALLED)),$(CORE_VENV)/installed)
CORE_PYTHON := $(dir $(CORE))bin/python

.PHONY: demo core quick mutants test nightly test-matrix test-wheels lint bags golden docs layouts site clean

demo: $(DEMO)
	@$(EVPINN) demo

test:
	@$(MAKE) --no-print-directory -j 2 lint $(COMPILED) $(ROS2_INSTALLED) $(MSGS_INSTALLED)
	@$(BIN)/python -m pytest $(IN_PARALLEL) --hypothesis-profile=ci -m "$(CHOSEN)"

# What every change runs, and with it the insides of benchmarks, captures and one case more of each.
nightly:
	@$(MAKE) --no-print-directory test CHOSEN=

# What finds most mistakes within a minute: tests without a mark of what costs (pyproject.toml).
quick: $(INSTALLED)
	@$(BIN)/ruff check
	@$(BIN)/python -m pytest $(IN_PARALLEL) --hypothesis-profile=quick --quick

# The loop of an edit to what learns: signals, estimation and energy, without what costs.
# Where nothing is installed yet, it installs the group `core` alone: no torch, no DDS, no SUMO.
# None of them waits, so there is one worker for each core.
core: JOBS := 2
core: $(CORE)
	@$(CORE_PYTHON) -m pytest $(IN_PARALLEL) --hypothesis-profile=quick --quick $(ROOMS)

# Whether `make core` finds a core that is broken: faults planted in it, one after the other.
# mutmut wants other versions of what the tools of `make lint` use, so it has an environment apart.
mutants: $(CORE_VENV)/installed
	@$(CORE_VENV)/bin/python -m pip install -qq 'mutmut>=3.8,<4'
	@$(CORE_VENV)/bin/mutmut run

# Both distributions that rclpy comes as wheels of: Kilted as `make test` has it, and Jazzy.
# PyTorch for Python 3.12 is a download of gigabytes.
JAZZY := .venv-jazzy
test-matrix: test
	@mkdir -p $(JAZZY)
	@{ grep -v '^ros-' constraints.txt; cat constraints-jazzy.txt; } > $(JAZZY)/constraints.txt
	@$(MAKE) --no-print-directory test VENV=$(JAZZY) PYTHON=$(PYTHON312) \
		CONSTRAINTS=$(JAZZY)/constraints.txt

# Wheel and sdist in a fresh environment of each Python. `WITHOUT=torch` saves gigabytes.
PYTHONS ?= python3.10 python3.11 python3.12 python3.13
test-wheels:
	@$(PYTHON) test/wheels.py $(PYTHONS) --without $(WITHOUT)

lint: $(INSTALLED)
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/hadolint Containerfile
	@$(BIN)/zizmor --offline --quiet .github
	@$(BIN)/mypy

# The recipe of the bundled bags is the one their README shows: from each line that starts
# `evpinn` to the first that does not go on.
bags: $(INSTALLED)
	@rm -rf bags/urban bags/highway
	@sed -n '/^evpinn /,/[^\\]$$/p' bags/README.md | PATH="$(CURDIR)/$(BIN):$$PATH" bash -eux

# What the bundled bags give: show what is different from the record, and write it down.
golden: $(INSTALLED)
	@$(BIN)/python test/replays/golden.py --renew

# The pictures of the documents and the reference pages, from code; that of the report needs Chromium.
docs: $(INSTALLED)
	@$(BIN)/python docs/benchmarks_picture.py
	@$(BIN)/python docs/eco_speed.py
	@$(BIN)/python docs/live_view.py
	@$(BIN)/python docs/generate.py
	@$(BIN)/python docs/report.py

# Pictures of the layouts for Foxglove and PlotJuggler: needs Chromium and npm.
layouts: $(INSTALLED)
	@$(BIN)/python docs/layouts.py

# The documents and every docstring of the public API as a site, in out/site.
site: $(INSTALLED)
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

clean:
	rm -rf $(VENV) $(CORE_VENV) $(JAZZY) mutants build install log *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache

$(COMPILED): $(INSTALLED)
	@$(BIN)/python -m pytest --collect-only -qq >/dev/null 2>&1; touch $@

# With them those that tests send as other stacks do: CAN frames and Autoware.
$(MSGS)/installed: $(INSTALLED) $(shell find evpinn_msgs test/messages -type f)
	@echo "Building evpinn_msgs and messages of others into $(MSGS); it takes a minute."
	@scripts/install.sh $(BIN)/python -c $(CONSTRAINTS) -r evpinn_msgs/requirements-build.txt
	@rm -rf $(MSGS)
	@for source in evpinn_msgs test/messages/*/; do \
		build=$(MSGS)/build/$$(basename $$source) && PATH="$(CURDIR)/$(BIN):$$PATH" && \
		cmake -S $$source -B $$build -GNinja -DBUILD_TESTING=OFF --log-level=ERROR \
			-DCMAKE_PROJECT_INCLUDE="$(CURDIR)/evpinn_msgs/cmake/wheels.cmake" \
			-DPython3_EXECUTABLE="$(CURDIR)/$(BIN)/python" \
			-DCMAKE_INSTALL_PREFIX="$(CURDIR)/$(MSGS)" >/dev/null && \
		cmake --build $$build -j 2 --target install >/dev/null || exit 1; \
	done
	@touch $@

$(VENV)/ros2/installed: $(INSTALLED)
	@echo "Installing launch and ros2 into $(VENV)/ros2 for the tests of launch files."
	@$(BIN)/python -m venv $(VENV)/ros2
	@$(ROS2_TOOLS)/install.sh "$(CURDIR)/$(VENV)/ros2"
	@touch $@

$(CORE_VENV)/installed: pyproject.toml constraints.txt
	@echo "Installing what the core needs into $(CORE_VENV); the first time takes half a minute."
	@test -x $(CORE_VENV)/bin/python || $(PYTHON) -m venv $(CORE_VENV)
	@$(CORE_VENV)/bin/python -m pip install -qq --upgrade 'pip>=25.1'
	@$(CORE_VENV)/bin/python -m pip install -qq --no-input --no-compile -c $(CONSTRAINTS) --group core
	@touch $@

# Python compiles a module where it is first imported: of PyTorch that is a small part.
$(VENV)/demo: EXTRAS := $(DEMO_EXTRAS)
$(INSTALLED) $(VENV)/demo: setup.py setup.cfg constraints.txt
	@echo "Installing evpinn_ros[$(EXTRAS)] into $(VENV); the first time takes a minute."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	@scripts/install.sh $(BIN)/python -c $(CONSTRAINTS) -e '.[$(EXTRAS)]'
	@touch $@
