# One command each: make demo, make test. See README.md.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Outside Linux with a CPU wheel at hand, PyTorch's own index avoids gigabytes of CUDA:
#   make setup TORCH_INDEX=https://download.pytorch.org/whl/cpu
TORCH_INDEX ?=
# Real recordings for the tests that use them; those tests skip without.
DGEVAL_REAL_DATA ?= $(abspath $(wildcard ../shared/data))
export DGEVAL_REAL_DATA

.PHONY: setup demo check test regress soak bench format clean

setup: $(VENV)/.done

$(VENV)/.done: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --upgrade pip
	$(BIN)/python -m pip install -q -c constraints.txt $(if $(TORCH_INDEX),--index-url $(TORCH_INDEX)) torch==2.13.0
	$(BIN)/python -m pip install -q -c constraints.txt -e ".[dev]"
	touch $@

demo: setup
	$(BIN)/dgeval inspect datasets/demo.mcap
	$(BIN)/dgeval replay datasets/demo.mcap datasets/ci-smoke/ci-smoke.toml --out runs/demo
	$(BIN)/dgeval report runs/demo
	@echo
	@echo "Look at runs/demo/report.html in a browser, and at the recording with"
	@echo "    $(BIN)/dgeval view runs/demo demo"

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest -m "not slow" -n 2 --dist loadfile

test: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache
	$(BIN)/python -m pytest -n 2 --dist loadfile --no-loadscope-reorder

regress: setup
	$(BIN)/dgeval regress datasets/ci-smoke/ci-smoke.toml --baseline reports/baselines/ci-smoke.zip --jobs 2

soak: setup
	$(BIN)/python tests/soak/damage_campaign.py --out reports/damage.md
	$(BIN)/python -m tests.soak.mutated_messages
	$(BIN)/python tests/soak/mutants.py
	DGEVAL_DRAWS=3 $(BIN)/python -m pytest tests/verdict/test_verdict.py -n 2
	$(BIN)/dgeval simulate conveyor --out runs/conveyor --jobs 2
	$(BIN)/dgeval replay runs/conveyor/conveyor.toml --out runs/conveyor/replay --no-review --jobs 2
	$(BIN)/python -m benchmarks.truth runs/conveyor/replay runs/conveyor/conveyor.toml
	$(BIN)/python -m benchmarks.simulation runs/conveyor/simulated.json --stability 4
	$(BIN)/dgeval report runs/conveyor/replay --truth runs/conveyor/conveyor.toml
	$(BIN)/python -m benchmarks.verdict
	$(BIN)/python -m benchmarks.robustness datasets/ci-smoke/ci-smoke.toml --work runs/robustness
	$(BIN)/python -m benchmarks.gate

bench: setup
	$(BIN)/python -m benchmarks.registration
	$(BIN)/python -m benchmarks.moving
	$(BIN)/python -m benchmarks.speed

format: setup
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

clean:
	rm -rf $(VENV) runs dist build .mypy_cache .ruff_cache
