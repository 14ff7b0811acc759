# Two commands: `make demo` makes a small real dataset, `make test` runs the tests. Both set up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo-dataset

.PHONY: help setup demo test test-slow check format bench lock wheel clean

help:
	@echo "make demo       set up, then make, render, validate and draw a small dataset"
	@echo "make test       set up, then run the tests"
	@echo "make test-slow  the tests that take longer"
	@echo "make check      lint, format, types, import contracts"
	@echo "make bench      every benchmark, one JSON object a line"
	@echo "make lock       write requirements.lock from the newest versions that fit"

setup: $(VENV)/.ready

$(VENV)/.ready: requirements.lock pyproject.toml scripts/system-libraries.sh
	bash scripts/system-libraries.sh
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -qq --disable-pip-version-check -r requirements.lock
	$(BIN)/python -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

demo: setup
	$(BIN)/doughdata generate --scenes rolls,doughnut --num-scenes 2 --dataset $(DEMO)
	$(BIN)/doughdata render --noise realsense --dataset $(DEMO)
	$(BIN)/doughdata validate --deep --dataset $(DEMO)
	$(BIN)/doughdata view --save $(DEMO)-sheet.png --dataset $(DEMO)

test: setup
	bash scripts/browser.sh
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile

test-slow: setup
	$(BIN)/python -m pytest -m slow

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --level error
	$(BIN)/lint-imports

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: setup
	@for file in $$(grep -l __main__ benchmarks/*.py); do $(BIN)/python $$file --json || exit 1; done

lock:
	bash scripts/lock.sh

wheel: setup
	$(BIN)/python -m build --wheel --no-isolation

clean:
	rm -rf $(VENV) dist build $(DEMO) $(DEMO)-sheet.png
