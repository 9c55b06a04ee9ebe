# make demo       install into .venv and measure a gold surface: out/gold_beckmann/
# make test-fast  install what the tests need and run the quick ones: three minutes on two cores
# make test       run all of them: ten minutes
# make lint       style and types
# make check      everything a change is held to before it is shared: lint and all tests
# make bench      speed against Embree alone and against renderers, growth, memory: benchmarks/RESULTS.md (half an hour)
# make gallery    the pictures of the README, drawn anew
# make clean      remove what these made
# make help       print these lines

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet

# Tests run side by side, and each on one core: linear algebra would take them all.
TEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses auto --dist worksteal

.PHONY: demo test-fast test lint check bench gallery clean help

demo: $(VENV)/demo
	$(BIN)/gonio run configs/gold_beckmann.toml

test-fast: $(VENV)/test
	$(TEST) -m "not slow" tests/unit tests/laws tests/cli

test: $(VENV)/test
	$(TEST)

lint: $(VENV)/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

check: lint
	$(TEST)

bench: $(VENV)/demo
	$(BIN)/python benchmarks/everything.py

gallery: $(VENV)/demo
	$(BIN)/python docs/gallery.py

clean:
	rm -rf $(VENV) build out *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis

help:
	@sed -n 's/^# \(make .*\)/\1/p' Makefile

# Installed in place, so that what runs and what is tested is what stands in this folder.
$(VENV)/demo: EXTRA :=
$(VENV)/test: EXTRA := [test]
$(VENV)/dev: EXTRA := [dev]
$(VENV)/demo $(VENV)/test $(VENV)/dev: pyproject.toml constraints.txt
	@echo "Installing into $(VENV) (two minutes the first time) ..."
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@$(PIP) install --constraint constraints.txt --editable '.$(EXTRA)'
	@touch $@
