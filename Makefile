# Both set-up commands make their own environment: `make demo` runs the paper's study, `make test` the
# tests. PYTHON chooses the interpreter, VENV the folder.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out/paper

.PHONY: demo test lint benchmark clean

demo: $(VENV)/installed
	$(VENV)/bin/cpid paper --out $(OUT)

test: $(VENV)/installed
	$(VENV)/bin/python -m pytest

lint: $(VENV)/installed
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

benchmark: $(VENV)/installed
	$(VENV)/bin/python tests/benchmarks/identifier_update.py

$(VENV)/installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit("Python 3.11 or newer is needed" if sys.version_info < (3, 11) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) out build dist
