# Everything a clone needs: python3 (3.11 or newer, with venv), git and make. `make` alone lists the targets.

PYTHON ?= python3
VENV := .venv$(if $(filter-out python3,$(PYTHON)),-$(notdir $(PYTHON)))
BIN := $(VENV)/bin

# Empty when PYTHON will do, else one line that says why not.
PROBLEM = $(shell $(PYTHON) -c 'import sys, venv, ensurepip; v = sys.version_info; \
  v < (3, 11) and print("tfg_drake needs Python 3.11 or newer; $(PYTHON) is %d.%d" % v[:2])' 2>/dev/null \
  || echo "$(PYTHON) does not run or has no venv module (on Debian: apt install python3-venv)")
require_python = $(if $(PROBLEM),$(error $(PROBLEM)))

.PHONY: help install demo test quick test-slow lint format types check pins docs kernels results figures clean

help:  ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile

install: $(VENV)/.demo  ## create the environment and compile the kernels, without a mission
	$(BIN)/python -m tfg_drake.diagrams.compile_kernels

demo: $(VENV)/.demo  ## explore a floor of 46 x 22 m at eight times real time, shown on a page
	$(BIN)/tfg-drake explore paper --realtime-rate 8

# Another Python is asked for by name (make test PYTHON=python3.12) and may be absent: that is no failure.
ifneq ($(PYTHON),python3)
test: skip := $(PROBLEM)
endif
test:  ## run the test suite (PYTHON=python3.12: with that Python, if it is there)
	@$(if $(skip),echo "skipped: $(skip)",$(MAKE) --no-print-directory suite)

# Three at a time: half of the time tests of robots wait. A file's tests share what one of them has set up; the files
# stay in the order of tests/conftest.py, the long ones first.
.PHONY: suite
suite: $(VENV)/.test
	$(BIN)/pytest -n 3 --dist loadfile --no-loadscope-reorder

# The core's, which need neither Drake nor robots, a page or whole missions.
QUICK := geometry mapfile mission planning safety slam tfg test_layers.py test_messages.py

quick: $(VENV)/.test  ## run the core's tests, two minutes
	$(BIN)/pytest -n 2 --dist loadfile $(QUICK:%=tests/%) --ignore tests/slam/test_robustness.py

test-slow: $(VENV)/.test  ## run the tests that take minutes
	$(BIN)/pytest -n 2 -m slow

lint: $(VENV)/.test  ## ruff's rules and format
	$(BIN)/ruff check
	$(BIN)/ruff format --check

format: $(VENV)/.test  ## rewrite the code in ruff's format
	$(BIN)/ruff check --fix-only --quiet
	$(BIN)/ruff format

types: $(VENV)/.test  ## mypy: strict for the core, relaxed for the Drake layers
	nice $(BIN)/mypy

# The linters run while tests wait.
check: $(VENV)/.test  ## what continuous integration runs: tests, lint, types
	@$(MAKE) --no-print-directory --jobs=2 suite lint types

# What stands in them already stays: delete them first to move to the newest versions.
pins:  ## write constraints-3.11.txt to constraints-3.14.txt for what pyproject.toml asks for
	$(PYTHON) -m venv build/pins && build/pins/bin/pip install -q uv
	for version in 3.11 3.12 3.13 3.14; do build/pins/bin/uv pip compile --quiet --no-header --no-annotate \
	  --all-extras --python-version $$version --output-file constraints-$$version.txt pyproject.toml; done

docs: $(VENV)/.docs  ## build the reference from the docstrings, with the diagrams, into build/reference
	$(BIN)/python docs/reference/build.py

kernels: $(VENV)/.test  ## list anew which kernels missions call, and with what types
	$(BIN)/python benchmarks/mission_kernels.py

results: $(VENV)/.test  ## make the tables of docs/results.md anew, some hours (DATA=FOLDER: those of recordings, too)
	$(BIN)/python benchmarks/results.py $(if $(DATA),--data $(DATA))

figures: $(VENV)/.test  ## make the figures of the docs anew, twenty minutes (DATA=FOLDER: the laser log's, too)
	$(BIN)/python benchmarks/figures.py $(if $(DATA),--data $(DATA))

clean:  ## remove the environments and every cache
	rm -rf .venv* build dist *.egg-info .*_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +

# The versions that the tests have passed with, of this Python; of one that is newer than all of them there are none.
PINS = $(wildcard constraints-$(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null).txt)

# One environment per Python. The demo needs no test tools; the tests' environment serves the demo as well. uv installs
# four times as fast as pip, which does it where an index is set up for pip alone.
install = $(require_python)@echo "installing into $(VENV), a minute the first time"; \
  $(PYTHON) -m venv $(VENV) && \
  { { $(pip) "uv>=0.5,<1" && $(uv); } 2>/dev/null || $(pip) $(wanted); }
pip = $(BIN)/python -m pip --disable-pip-version-check install -q --no-compile
uv = $(BIN)/uv pip install -q --no-cache --python $(BIN)/python $(wanted)
wanted = $(PINS:%=-c %) -e ".[$(extras)]"

# Tests find their kernels compiled; the demo shows a recorded mission while it compiles its own.
compile = @$(BIN)/python -m tfg_drake.diagrams.compile_kernels

$(VENV)/.demo: extras = export,serial
$(VENV)/.demo: pyproject.toml $(PINS)
	$(install)
	@touch $@

# Beside the tests' environment, or without.
$(VENV)/.docs: extras = docs
$(VENV)/.docs: pyproject.toml $(PINS)
	$(install)
	@touch $@

$(VENV)/.test: extras = test
$(VENV)/.test: pyproject.toml $(PINS)
	$(install)
	$(compile)
	@touch $@ $(VENV)/.demo
