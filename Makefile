# Every target makes its own environment in .venv: nothing but Python and make is needed.
# The stamps depend on pyproject.toml and constraints.txt, so that an edit there installs again.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt
PINS := pyproject.toml constraints.txt

.PHONY: help calibrate test test-slow validate stability bench accuracy docs lint format clean
.DELETE_ON_ERROR:

help:
	@echo "make calibrate   fit Young's modulus of the Turek-Hron beam; results in out/"
	@echo "make test        run the tests"
	@echo "make test-slow   run the tests that make test leaves out: a quarter of an hour"
	@echo "make validate    run every validation and every hard case; writes docs/results/*.json"
	@echo "make stability   run the hard cases alone, the second half of make validate"
	@echo "make bench       measure speed, ours beside others; writes docs/results/benchmark.json"
	@echo "make accuracy    what accuracy costs in time; writes docs/accuracy.md and its pictures"
	@echo "make docs        fill the tables, run the notebook, build the pages in docs/_build"
	@echo "make lint        ruff and the type checker"
	@echo "make clean       remove the environment and everything that was made"

calibrate: $(VENV)/.calibrate
	@mkdir -p out
	$(BIN)/python examples/calibrate_beam.py --out out --json out/calibrate_beam.json $(ARGS)

test: $(VENV)/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist loadfile $(ARGS)

# Both run, whatever the first one finds; with --only the ids are those of the validations.
validate: $(VENV)/.dev
	@mkdir -p docs/results
	@status=0; $(BIN)/python tests/validation/run.py $(ARGS) || status=1; \
	$(if $(findstring --only,$(ARGS)),,$(BIN)/python tests/stability/run.py $(ARGS) || status=1;) exit $$status

stability: $(VENV)/.dev
	@mkdir -p docs/results
	$(BIN)/python tests/stability/run.py $(ARGS)

test-slow: $(VENV)/.dev
	$(BIN)/python -m pytest --numprocesses auto --dist load -m slow $(ARGS)

bench: $(VENV)/.bench
	@mkdir -p docs/results
	$(BIN)/python tests/benchmarks/run.py $(ARGS)

accuracy: $(VENV)/.bench
	$(BIN)/python tests/accuracy/run.py $(ARGS)

docs: $(VENV)/.docs
	$(BIN)/python docs/build.py
	$(BIN)/python -m sphinx --fail-on-warning --keep-going -b html docs docs/_build/html

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) out build dist *.egg-info docs/_build .pytest_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# Editable installs: the environment runs the files of this tree. An extra once installed stays.
$(VENV)/bin/python:
	@echo "creating $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "jaxsph needs Python 3.11 or later: make PYTHON=python3.12 ...")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.calibrate: $(PINS) | $(VENV)/bin/python
	@echo "installing jaxsph and what the calibration needs into $(VENV)"
	$(PIP) --editable '.[plot]'
	@touch $@

$(VENV)/.dev: $(PINS) | $(VENV)/bin/python
	@echo "installing jaxsph and the development tools into $(VENV) (a few minutes the first time)"
	$(PIP) --editable '.[dev]'
	@touch $@

$(VENV)/.docs: $(PINS) | $(VENV)/bin/python
	@echo "installing jaxsph and the documentation tools into $(VENV)"
	$(PIP) --editable '.[docs]'
	@touch $@

$(VENV)/.bench: $(PINS) | $(VENV)/bin/python
	@echo "installing jaxsph and the codes it is measured against into $(VENV) (PySPH is compiled: a C++ compiler, minutes)"
	$(PIP) --editable '.[bench]'
	@touch $@
