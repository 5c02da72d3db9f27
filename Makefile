# make demo   sets up what it needs and explores an office with five robots over a radio of 50 bytes a step
# make test   sets up what it needs and runs format, lint, types, import rules and tests
# make quick  runs the fast tests, in less than 90 seconds
# make bench  prints ratios against named yardsticks
# make fuzz   gives every parser ten minutes of random and malformed bytes
# make figures  checks the measured figures in docs, which takes hours; FIGURES=--fast checks some
# make docs   builds the documentation as a site, in site/

VENV := .venv
PYTHON ?= python3
BIN := $(VENV)/bin
QUICK := tests/agent tests/protocol tests/netshaper tests/worldsim tests/murmur tests/fuzz $(addprefix tests/deploy/,scenario record chaos)
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile --constraint constraints.txt
# Bytecode of all packages but their tests, on all processors; pip uses one. Some packages have files for other versions
# of Python, which cannot be compiled, and are not needed.
COMPILE := $(BIN)/python -m compileall -qq -j 0 -x '/tests?/' $(VENV)/lib || true

# Tests start hundreds of processes, each of which would compile all modules again if the environment forbids bytecode.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: setup demo test quick check bench fuzz figures docs clean

setup: $(VENV)/main.stamp

# A bare Debian has Python without venv: fetch it where we may.
$(BIN)/python:
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); apt-get update && apt-get install -y --no-install-recommends python3-venv && $(PYTHON) -m venv $(VENV); }

$(VENV)/main.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable '.[view,mcap,film]'
	$(COMPILE)
	$(BIN)/murmur setup
	touch $@

$(VENV)/dev.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable '.[view,mcap,ros2,film,cluster,gym,pandas,docs,dev,bench]'
	$(COMPILE)
	$(BIN)/murmur setup
	touch $(VENV)/main.stamp $@

demo: setup
	$(BIN)/murmur explore --map office --robots 5 --bandwidth 50

# Kernels may have changed since the last set-up. Four workers occupy two cores: many tests wait for processes. A test that waits in vain
# prints the stacks of all threads after nine minutes and fails after ten.
test: $(VENV)/dev.stamp check
	$(BIN)/murmur setup
	$(BIN)/python -m pytest -n 4 --dist loadfile --no-loadscope-reorder \
	-o faulthandler_timeout=540 --timeout 600 --timeout-method thread --max-worker-restart 2

# All but the slow tests and those of commands, reports, studies, captures and swarms of processes.
quick: $(VENV)/dev.stamp
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder -m 'not long and not slow' $(QUICK)

check: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python tests/retired_words.py

bench: $(VENV)/dev.stamp
	$(BIN)/murmur bench

# Rounds of many inputs until ten minutes are over.
fuzz: $(VENV)/dev.stamp
	end=$$(($$(date +%s) + 600)); while [ $$(date +%s) -lt $$end ]; do \
	FUZZ_EXAMPLES=3000 timeout $$((end - $$(date +%s) + 1)) $(BIN)/python -m pytest -q tests/fuzz; code=$$?; \
	[ $$code = 0 ] || [ $$code = 124 ] || exit $$code; done

figures: $(VENV)/dev.stamp
	$(BIN)/python -m docs.figures $(FIGURES)

docs: $(VENV)/dev.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

clean:
	rm -rf $(VENV) build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
