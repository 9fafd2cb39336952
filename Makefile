# Everything sets itself up: only Python 3.11 or later with venv and pip is needed.
PYTHON ?= python3
VENV ?= .venv
JOBS ?= 2
LONGEST ?= none
OUT ?= demo-out
PEERS ?= .venv-peers
AEON ?= .venv-aeon
WARP ?= .venv-warp
WORK ?= reproduce-work
SEED ?= 1
ATTEMPTS ?= 20000

BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
PIP := --quiet --disable-pip-version-check --no-compile # a module is compiled when it is first imported

unexport PYTHONDONTWRITEBYTECODE # dozens of processes would each compile all that they import again

.DEFAULT_GOAL := help
.PHONY: help venv test aeon kernel lint format demo docs packages bench figures peers reproduce constraints attack sbom clean

help: ## list the targets
	@grep -E '^[a-z]+:.*##' Makefile | sed -E 's/:[^#]*## /\t/' | expand -t 13

venv: $(INSTALLED) ## make the virtual environment .venv, when pyproject.toml or constraints.txt changed

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo 'rcbht-jax needs Python 3.11 or later as "$(PYTHON)"; name another one: make PYTHON=python3.12 venv' >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install $(PIP) --constraint constraints.txt --editable '.[dev]'
	@touch $@

test: $(INSTALLED) ## run the tests but the longest; LONGEST=all runs every one, LONGEST=2/4 the second quarter of the longest
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder --long $(LONGEST)

aeon: $(AEON)/.installed ## run aeon's own checks of our estimators, in an environment of their own
	$(AEON)/bin/python -m pytest --noconftest --override-ini filterwarnings= tests/learning/test_aeon_estimators.py

$(AEON)/.installed: pyproject.toml
	$(PYTHON) -m venv $(AEON)
	$(AEON)/bin/python -m pip install $(PIP) --editable '.[aeon]' pytest
	@touch $@

kernel: $(WARP)/.installed ## test the engine fused with Warp on this CPU, in an environment of its own
	$(WARP)/bin/python -m pytest --noconftest --override-ini filterwarnings= tests/sim/engines/test_fused.py

$(WARP)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(WARP)
	$(WARP)/bin/python -m pip install $(PIP) --constraint constraints.txt --editable '.[sim,warp]' pytest
	@touch $@

lint: $(INSTALLED) ## check style, types and which module imports which
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

format: $(INSTALLED) ## fix the style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

demo: $(INSTALLED) ## simulate, label, train, evaluate, draw: OUT=folder; on recorded trials: DATA=folder
	$(BIN)/rcbht demo $(if $(DATA),--data $(DATA)) --out $(OUT)

docs: $(INSTALLED) ## build the documentation into the folder site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

packages: $(INSTALLED) ## build sdist and wheel, and try them in fresh environments outside the repository
	.ci/packages $(BIN)/python

bench: $(INSTALLED) ## compare the speed of the encoders with that of the commit in benchmarks/baseline; fail if one has fallen by more than 20 %
	$(BIN)/python -m tools.speed

reproduce: $(INSTALLED) $(PEERS)/.installed ## run all experiments, or resume; FORCE=1 repeats all, LONG=1 runs whole ones, RESULTS=folder writes there
	$(if $(RESULTS),RCBHT_RESULTS=$(RESULTS)) $(BIN)/python -m experiments.reproduce $(WORK) \
	  --peers $(PEERS)/bin/python --jobs $(JOBS) $(if $(FORCE),--force) $(if $(LONG),--long)

figures: $(INSTALLED) ## draw the figures and the film of the README, and write the tables and numbers of the pages, from the committed results
	$(BIN)/python -m experiments.figures.all
	$(BIN)/python -m tools.readme_film
	$(BIN)/python -m experiments.pages

peers: $(PEERS)/.installed ## measure other methods on the same folds, in an environment of their own
	$(PEERS)/bin/python -m experiments.classification.peers

$(PEERS)/.installed: pyproject.toml
	$(PYTHON) -m venv $(PEERS)
	$(PEERS)/bin/python -m pip install $(PIP) --editable '.[peers]'
	$(PEERS)/bin/python -m pip install $(PIP) --no-deps $$(grep '^scikit-learn==' constraints.txt) # or its folds are others
	@touch $@

constraints: $(INSTALLED) ## write the versions in .venv to constraints.txt
	$(BIN)/python -m pip freeze --exclude-editable > constraints.txt
	@touch $(INSTALLED)

attack: $(INSTALLED) ## attack every reader and writer with generated files, or resume: SEED=number ATTEMPTS=number
	$(BIN)/python -m tests.attacks --seed $(SEED) --attempts $(ATTEMPTS) --out attack.json

sbom: $(INSTALLED) ## write the software bill of materials of what is installed to sbom.json, and the page of licences
	$(BIN)/python -m tools.sbom sbom.json
	$(BIN)/python -m tools.sbom --table docs/licences.md

clean: ## remove what make and the tests leave behind
	rm -rf attack.json sbom.json $(VENV) $(PEERS) $(AEON) $(WORK) $(OUT) site build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .benchmarks
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
