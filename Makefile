# Two commands: `make demo` makes a small real dataset, `make test` runs the tests. Both set up first.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
DEMO := demo-dataset


# The model that ships: 400 scenes to learn from, 64 that are held out.
MODEL_DATA := model-dataset
MODEL_RUN := model-run
MODEL_PRESET := tiny
MODEL_MINUTES := 300
MODEL_REPORT := model-report
ABLATIONS := model-ablations

.PHONY: help setup demo test test-slow check format bench bench-model ablations report lock wheel clean

help:
	@echo "make demo       set up, then make, render, validate and draw a small dataset"
	@echo "make test       set up, then run the tests"
	@echo "make test-slow  the tests that take longer"
	@echo "make check      lint, format, types, import contracts"
	@echo "make bench      every benchmark, one JSON object a line"
	@echo "make bench-model  data, training, learning curve and table of the model; hours; resumes"
	@echo "make ablations  the training of the paper's table 2, three seeds; hours; goes on where it stopped"
	@echo "make report     one page of all tables and figures, from what bench-model and ablations left"
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

# Killed at any moment, the same command goes on. MODEL_MINUTES is the time of either stage.
bench-model: setup
	$(BIN)/doughdata generate --scenes rolls,doughnut --num-scenes 200 --seed 7 --dataset $(MODEL_DATA)
	$(BIN)/doughdata generate --scenes rolls,doughnut --num-scenes 32 --seed 7 --split test --dataset $(MODEL_DATA)
	$(BIN)/doughdata render --noise realsense --all-frames --dataset $(MODEL_DATA)
	for stage in autoencoder dynamics; do \
	  $(BIN)/doughnet train $$stage --preset $(MODEL_PRESET) --minutes $(MODEL_MINUTES) --resume \
	    --dataset $(MODEL_DATA) --out $(MODEL_RUN) || exit 1; done
	$(BIN)/python scripts/model_report.py --run $(MODEL_RUN) --dataset $(MODEL_DATA)

ablations: setup
	$(BIN)/python scripts/ablations.py --dataset $(MODEL_DATA) --out $(ABLATIONS)

report: setup
	$(BIN)/python scripts/report --weights $(MODEL_RUN) --dataset $(MODEL_DATA) \
	  --ablations $(ABLATIONS) --out $(MODEL_REPORT)

lock:
	bash scripts/lock.sh

wheel: setup
	$(BIN)/python -m build --wheel --no-isolation

clean:
	rm -rf $(VENV) dist build $(DEMO) $(DEMO)-sheet.png
