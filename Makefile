# Two commands do everything from nothing: `make paper` and `make test`. PYTHON chooses the interpreter.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT ?= out
SPAWNED := tests/execution tests/verification/test_pipeline.py tests/cli/test_run_quick.py \
	tests/artifacts/test_gain_table_file.py tests/codegen/test_every_equation.py

.PHONY: paper test test-thorough test-spawn lint bench evidence docs docs-test clean

paper: $(VENV)/.train
	$(BIN)/vsgdesign run studies/published/study.toml --out $(OUT)/published
	$(BIN)/vsgdesign run studies/field/study.toml --out $(OUT)/field

test: $(VENV)/.dev
	$(BIN)/python -m pytest

# What takes longer and is mostly seen by a quicker test as well: see tests/thorough.txt.
test-thorough: $(VENV)/.dev
	$(BIN)/python -m pytest --thorough

# As on Windows: no process is forked, and no text is UTF-8 by itself.
test-spawn: $(VENV)/.dev
	PYTHONUTF8=0 LC_ALL=C $(BIN)/python -m pytest -p tests.spawned $(SPAWNED)

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright

bench: $(VENV)/.dev
	$(BIN)/python -m bench

evidence: test-thorough
	$(BIN)/python -m evidence --out $(OUT)/evidence

docs: $(VENV)/.docs
	$(BIN)/python -m website

docs-test: $(VENV)/.dev
	$(BIN)/python -m pytest tests/docs -n 0

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/bin/python
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e .
	touch $@

$(VENV)/.train: $(VENV)/.installed
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[train]"
	touch $@

$(VENV)/.dev: $(VENV)/.installed
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[dev]"
	touch $@

$(VENV)/.docs: $(VENV)/.installed
	$(BIN)/python -m pip install -q --disable-pip-version-check -c constraints.txt -e ".[docs]"
	touch $@

clean:
	rm -rf $(VENV) $(OUT) build dist site *.egg-info
