# Two commands set up everything: `make demo` and `make test`. Both work in a virtual environment of their own (.venv)
# with the versions of requirements.lock, and need GNU make, git and Python 3.11 or later only.

VENV := .venv
BIN := $(VENV)/bin
LOCK := requirements.lock
PACKAGE := pipeline/mocap_id/__init__.py pyproject.toml

# The first Python on the path that will do; `make demo PYTHON=/path/to/python` chooses another.
SUITABLE := import sys, venv, ensurepip; sys.exit(sys.version_info < (3, 11))
NAMES := python3 python $(sort $(notdir $(wildcard $(addsuffix /python3.[1-9][0-9],$(subst :, ,$(PATH))))))
PYTHON ?= $(firstword $(foreach name,$(NAMES),$(shell $(name) -c '$(SUITABLE)' 2>/dev/null && echo $(name))))

PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint $(LOCK)
DEMO := sample_trials/sit-to-stand
TRIALS = $(wildcard sample_trials/*/trial.yaml)
RULES := $(VENV)/trials.mk
OPENSIM := .venv-opensim

.PHONY: help demo test test-slow proof house fuzz trials docs docs-site release-check lock opensim clean

help:
	@echo 'make demo    install, run the pipeline on a sample trial and print the path of the report'
	@echo 'make test    install the development tools, check and test everything, one process per core (WORKERS=1: one process)'
	@echo 'make test-slow   run the sweeps and other long tests, which make test leaves out; CI runs both'
	@echo 'make proof   compare every number and text of a corpus with those of a commit (BASE=HEAD PART=whole JOBS=1)'
	@echo 'make house   print the figures of the house: files, lines, functions, records, imports'
	@echo 'make fuzz    try damaged files (NUMBER=10000 SEED=1 JOBS=1); the same call continues where it stopped'
	@echo 'make trials  run every trial under sample_trials/; -j runs several at a time'
	@echo 'make docs    write the generated pages (commands, settings, examples of configurations)'
	@echo 'make docs-site   build the pages under docs/ into build/site/index.html'
	@echo 'make release-check   build the packages in dist/ and try them with every Python of this machine'
	@echo 'make lock    update the versions in requirements.lock'
	@echo 'make opensim create an environment with OpenSim, for some tests (400 MB)'
	@echo 'make clean   remove what the others made'

demo: $(VENV)/installed
	$(BIN)/mocap-id run $(DEMO)/trial.yaml

# Idle workers take tests from busy ones; what several tests share is made once (the fixture `once`).
WORKERS := logical
PYTEST = $(BIN)/python -m pytest -n $(patsubst 1,0,$(WORKERS)) --maxprocesses 8 --dist worksteal

test: $(VENV)/installed-dev
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/mocap-id doctor --warm
	$(PYTEST) -m 'not slow'
	$(BIN)/mocap-id regress sample_trials --baseline sample_trials/baseline.json

test-slow: $(VENV)/installed-dev
	$(PYTEST) -m slow

BASE := HEAD
PART := whole
JOBS := 1

proof: $(VENV)/installed-dev
	$(BIN)/python tests/proof/proof.py --base $(BASE) --part $(PART) --jobs $(JOBS)

house: $(VENV)/installed-dev
	$(BIN)/python tests/house/figures.py

NUMBER := 10000
SEED := 1

fuzz: $(VENV)/installed-dev
	$(BIN)/python tests/hostile/fuzz.py --number $(NUMBER) --seed $(SEED) --jobs $(JOBS) --state .fuzz

# The rules are generated from the list of stages; $(MAKE) passes -j and -k on to them.
trials: $(VENV)/installed
	@$(BIN)/mocap-id stages $(TRIALS:%=--make %) > $(RULES)
	@+$(MAKE) --no-print-directory -f $(RULES) MOCAP_ID=$(BIN)/mocap-id all

docs: $(VENV)/installed-dev
	$(BIN)/python -m mocap_id_cli.pages .

docs-site: $(VENV)/installed-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet
	@echo build/site/index.html

# Each Python gets a bare environment outside the source tree; PYTHONS='/path/to/python ...' chooses them.
release-check: $(VENV)/installed-dev
	$(BIN)/python tests/release/check_release.py --out dist $(PYTHONS:%=--python %)

lock: $(VENV)/installed-dev
	$(PIP_INSTALL) pip-tools
	CUSTOM_COMPILE_COMMAND='make lock' $(BIN)/python -m piptools compile --quiet --upgrade --strip-extras --extra dev \
	  --all-build-deps --allow-unsafe --no-emit-index-url --no-emit-trusted-host --no-emit-find-links \
	  --output-file $(LOCK) pyproject.toml

# OpenSim's wheel needs an environment of its own; tests/export looks for it here.
opensim: $(OPENSIM)/installed

$(OPENSIM)/installed: | require-python
	$(PYTHON) -m venv --clear $(OPENSIM)
	$(OPENSIM)/bin/python -m pip install --quiet --disable-pip-version-check --constraint $(LOCK) opensim==4.6
	@touch $@

$(VENV)/created: | require-python
	$(PYTHON) -m venv --clear $(VENV)
	@touch $@

# Without build isolation the build backend comes from the lock file too.
$(VENV)/installed: $(VENV)/created $(LOCK) $(PACKAGE)
	$(PIP_INSTALL) hatchling
	$(PIP_INSTALL) --no-build-isolation --editable .
	$(BIN)/mocap-id doctor --warm
	@touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(PIP_INSTALL) --no-build-isolation --editable '.[dev]'
	@touch $@

.PHONY: require-python
require-python:
	@test -n '$(PYTHON)' || { echo 'No Python 3.11 or later with venv was found: make … PYTHON=/path/to/python' >&2; exit 1; }

clean:
	rm -rf $(VENV) $(OPENSIM) build dist sample_trials/*/runs .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .fuzz .proof
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
