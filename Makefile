# Everything runs in .venv/, which every target brings up to date first. PYTHON picks the interpreter to make it with.
PYTHON ?= python3
PYTEST_ARGS ?=

# A shell in another environment of ROS wheels hands on their guard, with which this one would not find its libraries.
ifdef _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
endif

.DEFAULT_GOAL := help
.PHONY: help setup demo test test-long test-noble docs lint lock clean

help:  ## show this list
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 20

SETUP = command -v $(PYTHON) >/dev/null || { echo "setup: no $(PYTHON) found: set PYTHON to CPython 3.11, 3.12 or 3.13" >&2; exit 1; }; \
	$(PYTHON) tools/setup_environment.py $(if $(filter file,$(origin PYTHON)),,--python-was-chosen) $(WITH)
setup:  ## make .venv/ for the commands, or bring it up to date; WITH="dashboard files" adds what these need
	@$(SETUP)

demo: setup  ## run one experiment over DDS; bag, metrics and report go to runs/demo/
	.venv/bin/ehls experiment config/experiments/sine_fd2.yaml --out runs/demo --overwrite

# Plug-ins by name only: a sourced ROS brings some that do not work with this pytest. The limit ends tests that hang; no test
# comes near it on a slow machine, such as `python3 tools/held_back.py 0.33 make test` makes of any.
TIMEOUT := 1800
RUN_TESTS = PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv/bin/python -m pytest -p xdist -p timeout -n 2 --dist loadfile --timeout $(TIMEOUT)
test:  ## run the quick tests; PYTEST_ARGS='-k name' picks some
	@$(SETUP) test
	$(RUN_TESTS) -m "not long" $(PYTEST_ARGS)

test-long:  ## run the tests that take long: full products, endurance, browsers
	@$(SETUP) test
	$(RUN_TESTS) -m long $(PYTEST_ARGS)

test-noble:  ## run them with the versions of Ubuntu 24.04 in .venv-noble/; PYTHON=python3.12
	@EHLS_VERSIONS=noble $(PYTHON) tools/setup_environment.py
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv-noble/bin/python -m pytest -p xdist -p timeout -n 2 --dist loadfile \
		--timeout $(TIMEOUT) $(PYTEST_ARGS)

docs:  ## build the documentation into build/docs/ and check the layout of its pages
	@$(SETUP) docs
	.venv/bin/python -m sphinx --builder html --fail-on-warning --keep-going --fresh-env --quiet \
		--doctree-dir build/doctrees docs build/docs
	PYTEST_DISABLE_PLUGIN_AUTOLOAD=1 .venv/bin/python -m pytest -p timeout --timeout $(TIMEOUT) test/test_docs_pages.py
	@echo build/docs/index.html

lint:  ## check style, types and import contracts
	@$(SETUP) lint
	.venv/bin/ruff check
	.venv/bin/ruff format --check
	.venv/bin/mypy
	.venv/bin/lint-imports

# What holds for every supported machine is left out of the locks.
EVERYWHERE := python_full_version < '3.14' and platform_machine == 'x86_64' and platform_python_implementation == 'CPython' and \
	sys_platform == 'linux'
LOCK := uv pip compile --quiet --upgrade --universal --fork-strategy fewest --generate-hashes --no-annotate \
	--custom-compile-command "make lock"
FOR_NOBLE := noble ros colcon installer
FOR_ALL := base campaign docs fmu foxglove installer lint nidaqmx optimisers peers programme
lock:  ## pin the dependency groups of pyproject.toml anew (needs uv)
	@command -v uv >/dev/null || { echo "lock: no uv found: https://docs.astral.sh/uv" >&2; exit 1; }
	$(LOCK) --python-version 3.11 $(addprefix --group ,$(FOR_ALL)) -o requirements/lock.txt
	$(LOCK) --python-version 3.12 $(addprefix --group ,$(FOR_NOBLE)) -o requirements/noble.txt
	sed -i "s/ ; $(EVERYWHERE)//" requirements/*.txt

clean:  ## remove .venv/ and everything built, but no recordings
	rm -rf .venv .venv-noble build install log dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
