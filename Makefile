# Each target creates what it needs: a virtual environment in $(VENV) with the versions of constraints.txt.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed

.PHONY: demo test test-random lint

demo: $(INSTALLED)
	$(BIN)/diga3d demo --out run/demo

test: lint
	$(BIN)/pytest -n logical --dist worksteal

test-random: $(INSTALLED)
	$(BIN)/pytest -n logical --random-order-bucket=global

lint: $(INSTALLED)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy --num-workers 2

$(INSTALLED): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet -c constraints.txt -e '.[dev]'
	touch $@
