# Each set-up command makes its own environment: `make demo` runs the paper's study, `make test` the
# quick tests, `make test-slow` the others. PYTHON chooses the interpreter, VENV the folder, TESTS the
# tests.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out/paper
TESTS ?= tests

.PHONY: demo test test-slow lint docs benchmark clean

demo: $(VENV)/installed
	$(VENV)/bin/python diagrams/paper/run.py --out $(OUT) --force

# One thread each: the tests' matrices are small, and threads would only wait for each other.
PYTEST = OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal

test: $(VENV)/installed-dev
	$(PYTEST) -m "not slow" $(TESTS)

test-slow: $(VENV)/installed-dev
	$(PYTEST) -m slow $(TESTS)

lint: $(VENV)/installed-dev
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy

# The documentation: out/docs/index.html. The tutorials are executed. Each warning is an error.
docs: $(VENV)/installed-dev
	OPENBLAS_NUM_THREADS=1 $(VENV)/bin/sphinx-build -q -W --keep-going -n -d out/doctrees docs out/docs

# The figures of speed; it fails if one is beyond its limit. WRITE=--write renews the page of them.
benchmark: $(VENV)/installed-dev
	$(VENV)/bin/python tests/benchmark.py $(WRITE)

$(VENV)/installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --editable .
	touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(VENV)/bin/python -m pip install --quiet --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-3.* out build dist
