# make mesh    the demo object, end to end
# make test    every check and test
# make lint    the checks alone
# make viewer  bundles the report's scripts again after a change to their sources; needs node and npm
# make bench   measures the optimizers' kernels: rates, ratios, share of the processor's peak
# Each sets up .venv first where it is missing or older than the list of versions; PYTHON=... chooses another Python.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: mesh test lint bench viewer
.DELETE_ON_ERROR:

mesh: $(READY)
	$(BIN)/snakemake --cores 2 results/demo/mustard_bottle/2dgs.ply

test: lint
	$(BIN)/python -m pytest -q --durations=15

lint: $(READY)
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/ruff format --check src tests benchmarks
	$(BIN)/snakefmt --check workflow
	$(BIN)/snakemake --lint

bench: $(READY)
	$(BIN)/python benchmarks/kernels.py

viewer:
	cd src/zeroshop_steps/report/viewer && npm ci --no-audit --no-fund && node build.mjs

# torch goes first and alone: asked for together with others, pip may choose another build of it.
$(READY): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo 'error: $(PYTHON) is missing or older than 3.11. Install it (apt-get install python3 python3-venv) or run: make $(MAKECMDGOALS) PYTHON=/path/to/python3.11' >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null \
	  || { echo 'error: this Python cannot make environments. Install the missing part: apt-get install python3-venv' >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check "$$(grep '^torch==' requirements.lock)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@$(BIN)/python -m zeroshop_steps.runtime.check_install
	@touch $@
