# Everything a developer runs. The virtual environment is made by the first target that needs it.
.DEFAULT_GOAL := help
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SECONDS_OF_SOAK ?= 60
# Arguments of the benchmarks: names, --quick, --long, --json FILE, --plots FOLDER
BENCH ?=

.PHONY: help demo test check lint bench soak generated screenshots clean

help: ## Show the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 10

$(STAMP): pyproject.toml packaging/constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: apt-get install python3.11 python3.11-venv, or make PYTHON=python3"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint packaging/constraints.txt --editable '.[dev]'
	@touch $(STAMP)

demo: $(STAMP) ## Virtual robots, the gateway on them, live data: nothing else is needed
	@$(BIN)/robot-gateway demo

test: $(STAMP) ## All tests
	$(BIN)/pytest

lint: $(STAMP) ## Format, lint, types and import rules, without the tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	cd vendors/xcore/agent && $(CURDIR)/$(BIN)/mypy --config-file pyproject.toml
	$(BIN)/lint-imports

check: lint test ## What CI runs

bench: $(STAMP) ## Measure; every figure with its ratio to a baseline of the same run
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint packaging/constraints.txt --editable '.[bench]'
	@$(BIN)/python -m tests.bench $(BENCH)

soak: $(STAMP) ## The acceptance runs at their full length
	SOAK_SECONDS=$(SECONDS_OF_SOAK) $(BIN)/pytest -m soak -s

generated: $(STAMP) ## Write the generated files in config/ and docs/ anew
	$(BIN)/python -m tests.generated

screenshots: $(STAMP) ## Make the pictures of the dashboard in docs/images; needs Debian's chromium
	$(BIN)/python -m tests.screenshots

clean: ## Remove everything that was made
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
