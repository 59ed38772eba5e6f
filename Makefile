# securestate: every target sets up what it needs; `make help` lists them.
# PYTHON=/path/to/python3 chooses the interpreter of a new .venv; ARGS=... goes to the program a target runs.

PY := .venv/bin/python
ENVIRONMENT := .venv/.environment
KERNELS := .venv/.kernels
RUST_SOURCES := $(shell find crates -name '*.rs' -o -name Cargo.toml)
ARGS ?=

export PYTHON
export PYO3_PYTHON := $(CURDIR)/$(PY)
# cargo would look for make's job server in vain.
unexport MAKEFLAGS MFLAGS
# Without bytecode each of the many processes that the tests start compiles every module again.
unexport PYTHONDONTWRITEBYTECODE

# One thing after the other, but for the checks that `make test` runs side by side.
ifndef SIDE_BY_SIDE
.NOTPARALLEL:
endif
.DEFAULT_GOAL := help
.PHONY: help setup run test lint types contracts rust pytest bench papers arena format requirements clean

help: ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-13s %s\n", $$1, $$2 }' Makefile

setup: $(KERNELS) ## make .venv, install the dependencies, build the Rust kernels

run: setup ## the main job on the Tennessee Eastman data
	@$(PY) examples/tennessee-eastman/run.py $(ARGS)

test: $(ENVIRONMENT) ## every check; stops at the first failure
	@$(MAKE) --no-print-directory -j2 SIDE_BY_SIDE=1 lint contracts types rust
	@$(MAKE) --no-print-directory pytest

test lint types contracts rust pytest: export NO_COLOR := 1
test lint types contracts rust pytest: export CARGO_TERM_COLOR := never

lint: setup ## ruff: rules and format
	$(PY) -m ruff check --quiet .
	$(PY) -m ruff format --check --quiet --diff .

types: setup ## mypy --strict, and the kernels' stubs against the built module
	$(PY) -m mypy.stubtest --mypy-config-file scripts/stubtest.ini --concise --ignore-disjoint-bases \
	  securestate._kernels & stubs=$$!; \
	$(PY) -m mypy --no-color-output; types=$$?; wait $$stubs && exit $$types

contracts: setup ## imports point down only
	.venv/bin/lint-imports --no-logo

rust: $(ENVIRONMENT) ## rustfmt, clippy, cargo test
	cargo fmt --all --check
	cargo clippy --quiet --locked --workspace --all-targets -- -D warnings
	cargo test --quiet --locked

# One process per core already; threads of the linear algebra would wait for each other's cores.
pytest: export OPENBLAS_NUM_THREADS := 1
pytest: setup ## the Python tests and doctests; ARGS="-k name" narrows them
	$(PY) -m pytest -n auto --maxprocesses 4 $(ARGS)

bench: setup ## side-by-side benchmarks
	@$(PY) -m benches $(ARGS)

papers: setup ## reproduce the papers' numbers
	@$(PY) -m papers.liu2020 $(ARGS)
	@$(PY) -m papers.chen2022 $(ARGS)
	@$(PY) -m papers.zhu2022 $(ARGS)

arena: setup ## every estimator against every adversary; interrupted, it goes on where it stopped
	@.venv/bin/securestate compare examples/arena/suite.toml --out examples/arena/out --report examples/arena/out/report.html $(ARGS)

format: setup ## format Python and Rust in place
	$(PY) -m ruff check --quiet --fix-only .
	$(PY) -m ruff format --quiet .
	cargo fmt --all

requirements: $(ENVIRONMENT) ## recompile requirements/*.txt; ARGS=--upgrade for newer versions
	scripts/requirements.sh $(ARGS)

clean: ## remove .venv and everything built
	rm -rf .venv target src/securestate/_kernels*.so .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

# A stamp stands for work done; it is as new as what the work depends on. An environment whose Python no longer
# runs is made again.
ifneq ($(shell $(PY) -c 'print("runs")' 2>/dev/null),runs)
.PHONY: $(ENVIRONMENT)
endif

$(ENVIRONMENT): requirements/uv.txt requirements/dev.txt scripts/environment.sh
	@scripts/environment.sh
	@touch $@

$(KERNELS): $(ENVIRONMENT) pyproject.toml Cargo.toml Cargo.lock $(RUST_SOURCES) scripts/kernels.sh
	@scripts/kernels.sh
	@touch $@
