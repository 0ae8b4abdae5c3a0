# make demo | loop | discover | test | test-slow | test-ci | test-all | check | bench | docs | clean
#
# Everything runs in .venv, which is made when it is missing and updated when pyproject.toml changes.
# Another Python: make demo PYTHON=/path/to/python3

VENV := .venv
BIN := $(VENV)/bin
ENGINE := $(VENV)/engine
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# modules are compiled once, not in every process that tests start
unexport PYTHONDONTWRITEBYTECODE

ifeq ($(origin PYTHON),undefined)
# the first that starts: a shim may be on the path without a Python behind it
PYTHON := $(shell for p in python3.11 python3 python; do $$p -c "" 2>/dev/null && { echo $$p; break; }; done)
endif

.PHONY: help demo loop discover test test-slow test-ci test-all check bench docs clean
.NOTPARALLEL:
.DELETE_ON_ERROR:

help:
	@echo "make demo      build dist/sheep.fmu, run it elastic and viscoelastic, draw the figures"
	@echo "make loop      heart, human arteries and veins in a closed loop, two minutes; draw the figure"
	@echo "make discover  find what is missing in a model: two synthetic records, one minute"
	@echo "make test      run the tests: five to eight minutes on two cores"
	@echo "make test-slow run the long ones that make test leaves out: examples, snippets, hosts, whole records, statistics"
	@echo "make test-ci   both without whole records and statistics, as .ci/run does"
	@echo "make test-all  both in one run"
	@echo "make check     formatting, lint, types"
	@echo "make bench     measure speed and memory, and the accuracy of the fits"
	@echo "make docs      write the documentation and the API reference to build/docs"
	@echo "make clean     remove .venv and everything that was built"

demo: $(VENV)/installed-run $(ENGINE)
	$(BIN)/python examples/demo.py

loop: $(VENV)/installed-run $(ENGINE)
	$(BIN)/python examples/closed_loop.py

discover: $(VENV)/installed-run $(ENGINE)
	$(BIN)/python examples/discover.py

# A file runs on one core: its tests share fixtures, and the snippets of a document build on one another. The files
# that take longest come first (tests/conftest.py).
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile --no-loadscope-reorder

test: $(VENV)/installed-test $(ENGINE)
	$(PYTEST) -m "not slow and not deep and not endurance"

test-slow: $(VENV)/installed-test $(ENGINE)
	$(PYTEST) -m "slow or deep"

test-ci: $(VENV)/installed-test $(ENGINE)
	$(PYTEST) -m "not deep and not endurance"

test-all: $(VENV)/installed-test $(ENGINE)
	$(PYTEST) -m "not endurance"

check: $(VENV)/installed-dev
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff check .
	$(BIN)/python -m mypy

bench: $(VENV)/installed-run $(ENGINE)
	$(BIN)/python benchmarks/speed.py
	$(BIN)/python benchmarks/balance.py
	$(BIN)/python benchmarks/native.py
	$(BIN)/python benchmarks/fmu.py
	$(BIN)/python benchmarks/fit_speed.py
	$(BIN)/python benchmarks/wall_fits.py
	$(BIN)/python benchmarks/periods.py
	$(BIN)/python benchmarks/calibrations.py
	$(BIN)/python benchmarks/late_flow.py
	$(BIN)/python benchmarks/schemes.py

docs: $(VENV)/installed-docs
	@NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict --quiet
	@$(BIN)/python docs/api.py build/docs/api
	@$(BIN)/python docs/links.py build/docs
	@echo "Open build/docs/index.html"

clean:
	rm -rf $(VENV) build dist solver/engine *.egg-info .pytest_cache .hypothesis .ruff_cache .mypy_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# --- the virtual environment: one stamp per set of dependencies ---

$(BIN)/python:
	@if [ -z "$(PYTHON)" ]; then \
		echo "No Python found. Install Python 3.11 or newer, or say: make PYTHON=/path/to/python3"; exit 1; fi
	@"$(PYTHON)" -c 'import sys; v = "%d.%d" % sys.version_info[:2]; sys.exit(None if sys.version_info >= (3, 11) else \
		"$(PYTHON) is Python " + v + ", but 3.11 or newer is needed. Say: make PYTHON=/path/to/python3.11")'
	@echo "Making $(VENV) with $(PYTHON)"
	@"$(PYTHON)" -m venv $(VENV) || { rm -rf $(VENV); \
		echo "$(PYTHON) could not make a virtual environment. On Debian and Ubuntu: apt-get install python3-venv"; exit 1; }

$(VENV)/installed-run: pyproject.toml | $(BIN)/python
	@echo "Installing arterial-fmu into $(VENV); the first time takes a minute or two"
	@$(INSTALL) --editable .
	@touch $@

# the compiled engine, where there is a C compiler; a line says which
$(ENGINE): $(wildcard native/*.c native/*.h native/*.py) | $(VENV)/installed-run
	@$(BIN)/python native/build.py
	@touch $@

$(VENV)/installed-%: pyproject.toml | $(BIN)/python
	@echo "Installing arterial-fmu[$*] into $(VENV); the first time takes a minute or two"
	@$(INSTALL) --editable ".[$*]"
	@touch $@ $(VENV)/installed-run
