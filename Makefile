# Two commands do everything: `make bench` and `make test`. JOBS says in how many processes tests run.
PYTHON ?= $(firstword $(foreach p,python3.12 python3.11 python3 python,$(if $(shell $(p) -c 'import sys, venv, ensurepip; print(1 if (3, 11) <= sys.version_info < (3, 14) else "")' 2>/dev/null),$(p))))
BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check install --quiet --prefer-binary --progress-bar off --no-compile -c constraints.txt

JOBS ?= 2

# Where `make publish` puts the site: a branch of a remote, from which the host serves it.
REMOTE ?= origin
BRANCH ?= gh-pages

.PHONY: bench test suite test-slow lint docs publish notebooks dist pages clean

bench: .venv/.ready
	$(BIN)/twinbench run --profile quick

# Beside each other: types and pages keep one core busy for a minute.
test: .venv/.ready-dev
	@$(MAKE) --no-print-directory -j 3 lint docs suite

suite: .venv/.ready-dev
	$(BIN)/python -m pytest -n $(JOBS) --dist loadfile

test-slow: .venv/.ready-dev
	$(BIN)/python -m pytest -m slow

lint: .venv/.ready-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check --quiet .
	$(BIN)/mypy
	$(BIN)/lint-imports

# The pages and the reference as a site in site/; a warning is an error.
docs: .venv/.ready-dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build

# The site, built, as the only content of a branch of the remote.
publish: docs
	$(BIN)/ghp-import --no-history --no-jekyll --push --force --remote $(REMOTE) --branch $(BRANCH) site

# Every notebook with what it shows now.
notebooks: .venv/.ready-dev
	$(BIN)/python tests/helpers/notebooks.py

# Source distribution and wheel in dist/, as an index of packages would take them.
dist: .venv/.ready-dev
	rm -rf dist
	$(BIN)/hatchling build --target sdist --target wheel
	$(BIN)/twine check --strict dist/*

# Every block of a page that shows a file of results/ becomes that file as it is now.
pages: .venv/.ready
	$(BIN)/python -m twinbench.common.page_marks

clean:
	rm -rf .venv site dist results/quick .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis

.venv/bin/python:
	@test -n "$(PYTHON)" || { echo "twinbench needs Python 3.11, 3.12 or 3.13 with venv; install one, or name it: make PYTHON=/path/to/python3.12"; exit 2; }
	$(PYTHON) -m venv .venv

.venv/.ready: .venv/bin/python pyproject.toml constraints.txt
	@echo "Setting up .venv (a minute or two, once)"
	$(PIP) -e '.[export]'
	@touch $@

# Byte code is made on all cores: pip makes it on one. Tests of packages get none, nor what is in the syntax of another
# Python.
.venv/.ready-dev: .venv/bin/python pyproject.toml constraints.txt
	@echo "Setting up .venv (some minutes, once)"
	$(PIP) -e '.[dev]'
	@$(BIN)/python -W ignore -m compileall -qq -j 0 -x '/tests/' .venv/lib || true
	@touch .venv/.ready $@
