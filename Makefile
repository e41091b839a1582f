# From clone to book. `make help` explains each target in a line.
# Nothing is assumed but GNU make (3.81, macOS's own, or newer), git and a Python; a C compiler
# makes it faster.

# Candidates; the first that is recent enough is taken. `make PYTHON=/path/to/python` names one.
PYTHON ?= python3.11 python3.12 python3.13 python3.14 python3 python
# Installs the environment in seconds where present; `make UV=` does without.
UV ?= $(shell command -v uv 2>/dev/null)

PY := .venv/bin/python
install := $(if $(UV),"$(UV)" pip install --quiet --python $(PY),$(PY) -m pip install --quiet \
	--disable-pip-version-check)
# The oldest Python 3.x that will do, from pyproject.toml.
minor := $(shell sed -n 's/^requires-python = ">=3\.\([0-9]*\)".*/\1/p' pyproject.toml)
# Stamps that carry the checksum of what they were made from: neither a checkout's new
# time stamps nor a moved folder deceive them.
locked := .venv/locked-$(firstword $(shell cksum < environment.lock))
installed := .venv/installed-$(firstword $(shell (pwd; cat pyproject.toml) | cksum))

SHELL := /bin/sh
.SUFFIXES:
.DEFAULT_GOAL := all
MAKEFLAGS += --no-print-directory

# What a user's own set-up must not decide.
unexport PYTHONPATH PYTHONHOME MPLBACKEND
export IPYTHONDIR := $(CURDIR)/.venv/ipython
export JUPYTER_PREFER_ENV_PATH := 1

.PHONY: all help environment computed results figures notebooks book record lab bench test lint \
	verify seeds audit calibration sensitivity mutation lock clean distclean

all: book ## All that follows down to the book, then a comparison with the committed tables
	@$(PY) -m softwave_min compare
	@echo "Open book/_build/html/index.html"

help: ## This list
	@sed -n 's/^\([a-z]*\):[^#]*## \(.*\)/\1 \2/p' $(firstword $(MAKEFILE_LIST)) | \
	while read -r target line; do printf 'make %-12s %s\n' "$$target" "$$line"; done

environment: $(installed) ## Create .venv from environment.lock, every package by its hash

results: computed ## Compute the results that are missing or stale; compare with the committed ones
	@$(PY) -m softwave_min compare

figures: computed ## Draw every figure anew from the results
	@$(PY) -m softwave_min figures

notebooks: computed ## Execute the notebooks whose inputs changed
	@$(PY) notebooks/execute.py

book: notebooks ## Build the book if an input changed: book/_build/html/index.html
	@$(PY) book/build.py

record: environment ## Compute, execute, and write all that is to be committed, last digits included
	@$(PY) -m softwave_min run --record
	@$(PY) notebooks/execute.py --record

lab: computed ## Open the notebooks in JupyterLab
	@$(PY) -m jupyterlab notebooks

bench: environment ## Time the solvers beside their peers (installed apart), 15 minutes; judge the bars
	@$(PY) bench/run.py
	@$(PY) bench/plant_integrators.py
	@$(PY) bench/quadrature.py

# What a fresh clone lacks is computed; what is stale is an error, not a reason to compute.
# The notebooks are not executed before nbval does: the committed outputs are what it proves.
test: lint ## Style, types, layers, unit tests, every notebook and page; fails on stale results
	@$(PY) -m softwave_min status
	@$(PY) -m softwave_min run
	@$(PY) notebooks/execute.py --check
	@$(PY) book/build.py
	@$(PY) tests/helpers/browser.py
	@$(PY) -m pytest tests notebooks --nbval --numprocesses auto --maxprocesses 4

lint: environment ## Style (ruff), types (mypy) and layers (import-linter) of the source
	@$(PY) -m ruff check --quiet .
	@$(PY) -m ruff format --quiet --check .
	@$(PY) -m mypy
	@.venv/bin/lint-imports --no-logo --cache-dir .build/layers

verify: environment ## Compute everything once more, elsewhere, and compare with the committed tables
	@$(PY) -m softwave_min verify

seeds: environment ## The headline numbers in 20 random seas: six minutes
	@$(PY) -m softwave_min run random_seas

audit: environment ## All that is computed on request: seas, stars, readings, ablations; 20 minutes
	@$(PY) -m softwave_min run random_seas star_sweep star_drag ablations open_points

calibration: environment ## Search for the parameters that come closest to the paper's numbers
	@$(PY) -m softwave_min calibrate

sensitivity: environment ## Which open parameters decide the headline numbers: three quarters of an hour
	@$(PY) -m softwave_min sensitivity

mutation: environment ## Break every line of the arm and the waves and see whether a test notices
	@$(PY) tests/mutation.py

lock: ## Resolve requirements.in into environment.lock (needs uv)
	@$(if $(UV),,$(error 'make lock' needs uv))
	@"$(UV)" pip compile --quiet --universal --python-version 3.$(minor) --generate-hashes \
		--no-header --no-annotate requirements.in --output-file environment.lock

clean: ## Remove the book, the notebooks' stamps and the caches
	@rm -rf .build book/_build .hypothesis .mypy_cache .pytest_cache .ruff_cache
	@find . -name .venv -prune -o -name __pycache__ -prune -exec rm -r {} +

distclean: clean ## Remove the computed runs and the environment as well
	@rm -rf results/runs results/sets/*/runs .venv

computed: environment
	@$(PY) -m softwave_min run

# The path of the first candidate that is recent enough, else 'none:' and what was found.
find_python = found=; for candidate in $(PYTHON); do \
	version=$$("$$candidate" -c 'import sys; print("%d.%d" % sys.version_info[:2])' 2>/dev/null) \
		|| continue; \
	if [ "$${version%%.*}" -eq 3 ] && [ "$${version\#*.}" -ge $(minor) ]; then \
		exec "$$candidate" -c 'import sys; print(sys.executable)'; \
	fi; \
	found="$$found $$candidate is $$version;"; \
done; echo "none:$${found:- no Python at all;}"

too_old = Python 3.$(minor) or newer is needed; found: $(strip $(python:none:%=%)) name one with PYTHON=/path/to/python

$(locked):
	@$(eval python := $(shell $(find_python)))
	@$(if $(filter none:%,$(python)),$(error $(too_old)))
	@rm -rf .venv
	@echo "environment: installing environment.lock with $(if $(UV),uv,pip) for $(python)"
	@$(if $(UV),"$(UV)" venv --quiet --python "$(python)" .venv,"$(python)" -m venv .venv)
	@$(install) --require-hashes -r environment.lock
	@touch $@

$(installed): $(locked)
	@rm -f .venv/installed-*
	@$(install) --no-deps --no-build-isolation -e .
	@touch $@
