# Everything a developer runs. The virtual environment is made by the first target that needs it.
.DEFAULT_GOAL := help
PYTHON ?= python3.11
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
SECONDS_OF_SOAK ?= 60
# Arguments of the benchmarks: names, --quick, --long, --json FILE, --plots FOLDER
BENCH ?=
SECONDS ?= 60
TARGETS ?=
DOCKER ?= docker
# How many processes run tests; the time-outs of the tests are meant for two on two cores.
PROCESSES ?= 2
# Hundreds of tests start the gateway: where images of Python forbid it to keep what it compiles, each would compile it anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo test check lint bench soak generated screenshots image deb fuzz clean

help: ## Show the targets
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*##/\t/' | expand -t 13

$(STAMP): pyproject.toml packaging/constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: apt-get install python3.11 python3.11-venv, or make PYTHON=python3"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --constraint packaging/constraints.txt --editable '.[dev]'
	@touch $(STAMP)

demo: $(STAMP) ## Virtual robots, the gateway on them, live data: nothing else is needed
	@$(BIN)/robot-gateway demo

test: $(STAMP) ## All tests: much of their time is waiting, so several at a time, then those that need the machine alone
	$(BIN)/pytest -m 'not alone' --numprocesses $(PROCESSES) --dist loadfile --no-loadscope-reorder
	$(BIN)/pytest -m alone

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

soak: $(STAMP) ## The acceptance runs, SECONDS_OF_SOAK each; with MINUTES=60 the faults instead, for so long, with a report
ifdef MINUTES
	$(BIN)/python -m tests.faults --minutes $(MINUTES)
else
	SOAK_SECONDS=$(SECONDS_OF_SOAK) $(BIN)/pytest -m soak -s
endif

fuzz: $(STAMP) ## Fuzz each target for SECONDS, or only TARGETS="config foxglove": needs Python 3.11
	@$(BIN)/python -c 'import atheris' 2>/dev/null || $(BIN)/pip install --quiet --disable-pip-version-check --constraint packaging/constraints.txt --editable '.[fuzz]'
	@$(BIN)/python -m tests.fuzz --seconds $(SECONDS) $(TARGETS)

generated: $(STAMP) ## Write the generated files in config/ and docs/ anew
	$(BIN)/python -m tests.generated

screenshots: $(STAMP) ## Make the pictures of the dashboard in docs/images; needs Debian's chromium
	$(BIN)/python -m tests.screenshots

image: ## Build the container image robot-gateway:VERSION; DOCKER=podman builds it without Docker
	version=$$(sed -n 's/^version = "\(.*\)"$$/\1/p' pyproject.toml) && BUILDAH_FORMAT=docker $(DOCKER) build \
		--build-arg VERSION="$$version" --build-arg REVISION="$$(git rev-parse HEAD 2>/dev/null || echo unknown)" \
		--tag robot-gateway:"$$version" --tag robot-gateway:latest .

deb: $(STAMP) ## Build the Debian package dist/robot-gateway_VERSION_ARCH.deb
	@$(BIN)/python packaging/deb/build.py

clean: ## Remove everything that was made
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
