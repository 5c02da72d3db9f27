# make demo   sets up what it needs and explores an office with five robots
# make test   sets up what it needs and runs format, lint, types, import rules and tests
# make bench  prints ratios against named yardsticks
# make docs   builds the documentation as a site, in site/

VENV := .venv
PYTHON ?= python3
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: setup demo test check bench docs clean

setup: $(VENV)/main.stamp

# A bare Debian has Python without venv: fetch it where we may.
$(BIN)/python:
	$(PYTHON) -m venv $(VENV) || { rm -rf $(VENV); apt-get update && apt-get install -y --no-install-recommends python3-venv && $(PYTHON) -m venv $(VENV); }

# Compiles all kernels, once, into numba's cache.
$(VENV)/main.stamp: pyproject.toml constraints.txt | $(BIN)/python
	$(PIP) --editable '.[view,mcap,film]'
	$(BIN)/python -c 'import deploy.run.preload'
	touch $@

$(VENV)/dev.stamp: $(VENV)/main.stamp
	$(PIP) --editable '.[view,mcap,film,cluster,docs,dev,bench]'
	touch $@

demo: setup
	$(BIN)/murmur explore --map office --robots 5 --bandwidth 10000

test: $(VENV)/dev.stamp check
	$(BIN)/python -m pytest -n 2 --dist loadfile

check: $(VENV)/dev.stamp
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: $(VENV)/dev.stamp
	$(BIN)/murmur bench

docs: $(VENV)/dev.stamp
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict

clean:
	rm -rf $(VENV) build dist site *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -prune -exec rm -rf {} +
