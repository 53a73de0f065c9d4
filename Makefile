# What people do every day. `make demo`, `make video` and `make test` do all the set-up they need.
PYTHON ?= python3
BIN := .venv/bin

.PHONY: setup demo video test lint format docs bench clean

setup: .venv/ready

.venv/ready: pyproject.toml constraints.txt
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[test,lint]"
	touch $@

# A lifter trained on simulated people, and beside it the ready one on others that neither has seen.
demo: setup
	$(BIN)/uplift fit task=demo
	rm -rf build/demo && mkdir -p build/demo
	$(BIN)/uplift simulate skeleton=h36m17 output=build/demo/others.npz frames=600 seed=1
	$(BIN)/uplift predict run=runs/demo/last input=build/demo/others.npz output=build/demo/trained.html
	$(BIN)/uplift predict run=person input=build/demo/others.npz output=build/demo/ready.html

# A real video to poses with the ready lifter, nothing trained; no network once it is set up.
WALK := build/video/Sports2D/Demo/demo.mp4

video: .venv/video $(WALK)
	rm -f build/video/poses.html
	$(BIN)/uplift predict run=person input=$(WALK) output=build/video/poses.html

.venv/video: .venv/ready
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable ".[video]"
	$(BIN)/uplift detectors get mediapipe
	touch $@

$(WALK):  # Sports2D's demo, BSD-3-Clause
	$(BIN)/python -m pip download --quiet --no-deps --dest build/video sports2d==0.8.34
	$(BIN)/python -m zipfile --extract build/video/sports2d-0.8.34-py3-none-any.whl build/video
	touch $@

test: setup
	$(BIN)/python -m pytest -n auto --maxprocesses 8 --dist loadfile

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/basedpyright
	$(BIN)/lint-imports

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

docs: setup
	$(BIN)/python -m benchmarks.settings_tables

bench: setup
	$(BIN)/python -m benchmarks

clean:
	rm -rf .venv build dist
