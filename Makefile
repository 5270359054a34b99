# Every target sets up what it needs. TORCH_INDEX: an extra package index, such as PyTorch's own for CPU-only builds.
PYTHON ?= python3
BIN := .venv/bin
READY := .venv/.ready

.PHONY: install benchmark test lint train policies figures clean

install: $(READY)  ## everything into .venv

benchmark: $(READY)  ## all that is shipped, compared: tables here, report in runs/standard/report.html
	$(BIN)/kerfgym benchmark --shipped --name standard --overwrite

# As many tests at a time as there are cores: threads of linear algebra beside them would only wait for each other.
test: $(READY)  ## all tests, a file after the other on each core
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest -n auto --dist loadfile

train: $(READY)  ## the best follower once more, and whether it comes out as before
	$(BIN)/python -m kerfgym.experiments.studies.ship --check height-following-gradient

policies: $(READY)  ## the shipped policies anew
	$(BIN)/python -m kerfgym.experiments.studies.ship

figures: $(READY)  ## what README and manual show and is older than the code, measured anew
	$(BIN)/python -m kerfgym.experiments.manual --stale

lint: $(READY) build/types/kerfgym/envs  ## style and types
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

clean:  ## everything that can be made again, except runs
	rm -rf .venv build .pytest_cache .mypy_cache .ruff_cache *.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps \
	  $(if $(TORCH_INDEX),--extra-index-url $(TORCH_INDEX)) torch==2.13.0
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@

# mypy needs the package's name for folders that stand at the top.
build/types/kerfgym/envs:
	mkdir -p build/types/kerfgym
	for part in envs baselines agents experiments __init__.py; do ln -sfn ../../../$$part build/types/kerfgym/$$part; done
