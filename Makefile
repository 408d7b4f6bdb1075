# Each target makes its own environment in .venv, of the Python given: make demo PYTHON=python3.12
PYTHON ?= python3
BIN := .venv/bin

# The environment is complete in itself: a sourced ROS or another environment must not reach into it.
unexport PYTHONPATH PYTHONHOME PYTHONSTARTUP LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH ROS_DISTRO RMW_IMPLEMENTATION

.PHONY: help demo test bench firmware lint clean environment-run environment-dev suitable

help:
	@echo "make demo     run the emulated robot along the reference line and write the report"
	@echo "make test     run all tests"
	@echo "make bench    measure speed and accuracy into out/bench.json"
	@echo "make firmware build the friction rig's firmware: 8051, ATmega328P, native"
	@echo "make lint     ruff and mypy"
	@echo "make clean    remove the environment and what was built; results in out/ stay"
	@echo "ARGS='...' is handed on: make test ARGS='-k lugre'; PYTHON=python3.12 chooses the interpreter"

demo: environment-run
	@$(BIN)/rx90_demo $(ARGS)

test: environment-dev
	@$(BIN)/python -m pytest -n 2 --dist worksteal $(ARGS)

firmware:
	@$(MAKE) --no-print-directory -C firmware

bench: environment-dev
	@$(BIN)/python -m benchmarks $(ARGS)

lint: environment-dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy

clean:
	@rm -rf .venv build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

environment-run environment-dev: environment-%: suitable
	@"$(PYTHON)" tools/environment.py $*

# Asked for here, because an older interpreter cannot even parse the set-up script.
suitable:
	@"$(PYTHON)" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || \
	  { echo "PYTHON=$(PYTHON) is $$("$(PYTHON)" --version 2>&1 | tail -n 1);" \
	    "accepted: CPython 3.10 to 3.13, for example PYTHON=python3.12" >&2; exit 1; }
