# `make demo` and `make test` need python3 with its venv module, and the package index.
PYTHON ?= python3
JOBS ?= 2
VENV := .venv
BIN := $(VENV)/bin
EVPINN := $(BIN)/evpinn
INSTALLED := $(VENV)/installed

# A sourced ROS 2 brings its own rclpy; without one it comes as wheels, with the extra `ros`.
ifdef ROS_DISTRO
VENV_OPTIONS := --system-site-packages
EXTRAS := dev,bench
else
EXTRAS := dev,ros,bench
endif

# Nodes started here meet no other robot, and workers side by side take one core each.
export ROS_AUTOMATIC_DISCOVERY_RANGE := LOCALHOST
export ROS_DOMAIN_ID := 86
export OMP_NUM_THREADS := 1

.PHONY: demo test lint bags docs clean

demo: $(INSTALLED)
	@$(EVPINN) demo

test: lint
	@$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --hypothesis-profile=ci

lint: $(INSTALLED)
	@$(BIN)/ruff check
	@$(BIN)/ruff format --check
	@$(BIN)/mypy

# The recipe of the bundled bags is the one their README shows: from each line that starts
# `evpinn` to the first that does not go on.
bags: $(INSTALLED)
	@rm -rf bags/urban bags/highway
	@sed -n '/^evpinn /,/[^\\]$$/p' bags/README.md | PATH="$(CURDIR)/$(BIN):$$PATH" bash -eux

# The pictures of the README and the reference pages, from code; that of the report needs Chromium.
docs: demo
	@cp out/demo/demo.png docs/demo.png
	@$(BIN)/python docs/eco_speed.py
	@$(BIN)/python docs/generate.py
	@$(BIN)/python docs/report.py

clean:
	rm -rf $(VENV) build install log *.egg-info .hypothesis .mypy_cache .pytest_cache .ruff_cache

$(INSTALLED): setup.py setup.cfg constraints.txt
	@echo "Installing evpinn_ros and its tools into $(VENV); the first time takes minutes."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV_OPTIONS) $(VENV)
	@$(BIN)/python -m pip install -qq --no-input --disable-pip-version-check \
		-c constraints.txt -e '.[$(EXTRAS)]'
	@touch $@
