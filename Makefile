# Two commands matter: `make demo` and `make test`. Each sets up what it needs.
SHELL  := /bin/bash
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check

.PHONY: help demo test lab soak chaos soak-cameras check format bench lock clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /: /'

$(VENV)/.run: requirements/run.lock pyproject.toml requirements/venv
	@requirements/venv "$(PYTHON)" "$(VENV)"
	$(PIP) install --quiet --require-hashes -r requirements/run.lock
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(VENV)/.dev: $(VENV)/.run requirements/dev.lock
	$(PIP) install --quiet --require-hashes -r requirements/dev.lock
	@touch $@

demo: $(VENV)/.run  ## the main job on the simulated cell: a tray of 12 sticks is emptied on a PLC's orders
	$(BIN)/mikado demo

test: $(VENV)/.dev  ## all tests that need no hardware
	$(BIN)/pytest -q -n 2 --dist loadfile --ignore tests/lab
	$(BIN)/pytest -q -n 0 tests/lab/test_chaos.py tests/lab/test_garbage.py tests/lab/test_soak.py

lab: $(VENV)/.dev  ## short forms of all lab tests, one after the other, with peers that tests/lab/setup.sh installs
	$(BIN)/pytest -q -n 0 -rs tests/lab

PICKS ?= 200
soak: $(VENV)/.dev  ## a long run over RTDE, with safety stops in between: 200 picks, half an hour (PICKS=N); a minute of Modbus nonsense
	$(BIN)/pytest -q -s -n 0 tests/lab/test_soak.py tests/lab/test_garbage.py --picks $(PICKS) --garbage-s 60

chaos: $(VENV)/.dev  ## bad nights: picks with random faults on two simulated cells side by side (PICKS=2000 for a long one)
	$(BIN)/pytest -q -s -n 0 tests/lab/test_chaos.py --picks $(PICKS)

MINUTES ?= 30
soak-cameras: $(VENV)/.dev  ## two GigE Vision cameras at 30 frames a second, then two webcams, half an hour each (MINUTES=N), as root
	$(BIN)/pytest -q -s -n 0 -rs tests/lab/test_gige_soak.py tests/lab/test_v4l2_soak.py --minutes $(MINUTES)

check: $(VENV)/.dev  ## ruff, mypy --strict, import-linter
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev  ## rewrite the code in the project's format
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(VENV)/.bench: $(VENV)/.run requirements/bench.lock
	$(PIP) install --quiet --require-hashes -r requirements/bench.lock
	@touch $@

bench: $(VENV)/.bench  ## accuracy, peers, robustness, speed into docs/benchmarks.md, about five minutes (SCENES=FOLDER BENCH="--effort long")
	$(BIN)/python -m bench.report --out docs/benchmarks.md $(if $(SCENES),--scenes "$(SCENES)") $(BENCH)

# built from source, these need a compiler and files from the network
WHEELS := --only-binary ur-rtde --only-binary ur-analytic-ik --emit-build-options

# needs `uv` on the path; everybody else installs from the locks as they are
lock:  ## make requirements/*.lock anew from pyproject.toml
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-emit-find-links --no-header $(WHEELS) pyproject.toml requirements/build.in -o requirements/run.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-emit-find-links --no-header $(WHEELS) pyproject.toml requirements/build.in --group dev \
	  -c requirements/run.lock -o requirements/dev.lock
	uv pip compile -q --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
	  --no-emit-find-links --no-header $(WHEELS) pyproject.toml requirements/build.in --group bench \
	  -c requirements/run.lock -o requirements/bench.lock

clean:  ## remove what the commands above made
	rm -rf $(VENV) demo-out look-out results build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
