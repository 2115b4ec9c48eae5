# One command from a fresh clone: `make demo` or `make test`. Each sets up .venv first.
#
# Variables: PYTHON (an interpreter of version 3.10 or 3.11), JOBS (worker processes),
# EPISODES and OUT (of the demo). pip's own settings (PIP_INDEX_URL and the like) are honoured.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

CORES := $(shell nproc 2>/dev/null || getconf _NPROCESSORS_ONLN)
JOBS ?= $(shell echo $$(( $(CORES) < 4 ? $(CORES) : 4 )))
EPISODES ?= 20
OUT ?= results/demo
BIN := .venv/bin

.PHONY: help install demo test lint format docs

help:
	@echo "make install   set up .venv with everything (done by the others when needed)"
	@echo "make demo      plan and execute $(EPISODES) episodes of Placement; table, figure, video"
	@echo "make test      ruff, mypy and all tests"
	@echo "make lint      ruff and mypy only"
	@echo "make format    format the code"
	@echo "make docs      build the documentation (Python 3.11): docs/_build/html/index.html"

install: .venv/installed

.venv/installed: pyproject.toml constraints.txt
	@works='import ensurepip, sys, venv; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 11))'; \
	if ! $(BIN)/python -m pip --version >/dev/null 2>&1; then \
	  found=; \
	  for python in $(or $(PYTHON),python3.11 python3.10 python3 python); do \
	    if "$$python" -c "$$works" >/dev/null 2>&1; then found=$$python; break; fi; \
	  done; \
	  if [ -z "$$found" ]; then \
	    echo "error: this needs Python 3.10 or 3.11 with venv; tried $(or $(PYTHON),python3.11 python3.10 python3 python)." >&2; \
	    echo "Install one, or name it: make install PYTHON=/path/to/python3.11" >&2; \
	    exit 1; \
	  fi; \
	  echo "setting up .venv with $$("$$found" --version)"; \
	  "$$found" -m venv --clear .venv; \
	fi
	# torch alone first: the rest then accepts whichever build of it pip's settings give.
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt torch
	$(BIN)/python -m pip install --disable-pip-version-check -c constraints.txt -e '.[all,dev,docs]'
	@touch $@

demo: install
	$(BIN)/smp-bench run --tasks Placement --methods smp,promp --episodes $(EPISODES) \
	  --jobs $(JOBS) --restart --out $(OUT)

test: lint
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

format: install
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

docs: install
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build/html
	@echo "docs/_build/html/index.html"
