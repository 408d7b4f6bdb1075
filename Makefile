# Each target makes its own environment in .venv, of the Python given: make demo PYTHON=python3.12
PYTHON ?= python3
BIN := .venv/bin

# The environment is complete in itself: a sourced ROS or another environment must not reach into it.
unexport PYTHONPATH PYTHONHOME PYTHONSTARTUP LD_LIBRARY_PATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
unexport AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH ROS_DISTRO RMW_IMPLEMENTATION
# Without kept bytecode each worker rewrites the assertions of all tests, and each process compiles all modules anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo view action test test-fast test-jazzy bench docs firmware lint clean environment-run environment-dev environment-docs environment-jazzy packages suitable

help:
	@echo "make demo     run the emulated robot along the reference line and write the report"
	@echo "make view     the same arm on a page in the browser, moving along the reference line until Ctrl-C"
	@echo "make action   build control_msgs, controller_manager_msgs and tf2_msgs into the environment: the action, found as a controller, /tf"
	@echo "make test     install what the tests need, as far as that may be, and run all of them"
	@echo "make test-fast  run within a minute those that need no DDS, no browser and no firmware: while editing"
	@echo "make test-jazzy  run the tests of models, loop, bags and identification with the versions of Ubuntu 24.04"
	@echo "make bench    measure speed and accuracy into out/bench.json"
	@echo "make docs     build the site of the documentation into out/docs"
	@echo "make firmware build the friction rig's firmware: 8051, ATmega328P, native"
	@echo "make lint     ruff, mypy, and the counts of habits that may only fall"
	@echo "make clean    remove the environment and what was built; results in out/ stay"
	@echo "ARGS='...' is handed on: make test ARGS='-k lugre'; PYTHON=python3.12 chooses the interpreter"

demo: environment-run
	@$(BIN)/rx90 demo $(ARGS)

view: environment-run
	@$(BIN)/rx90 view --demo $(ARGS)

action: environment-run
	@$(BIN)/python -m tools.interfaces

# Exit code 1: it cannot be built here, and has said why; the tests that need it are skipped.
# Three at once on two cores: many tests wait for nodes and pages that are paced by a clock.
test: packages environment-dev
	@$(BIN)/python -m tools.interfaces || [ $$? -eq 1 ]
	@$(BIN)/python -m pytest -n 3 --dist worksteal --durations=10 $(ARGS)

FAST := test/rx90_sim test/rx90_controller test/rx90_common test/rx90_emulator/loop test/rx90_emulator/identification
test-fast: environment-dev
	@$(BIN)/python -m pytest -n 2 --dist worksteal -m "not ros and not firmware and not browser and not slow" \
	  $(or $(ARGS),$(FAST))

# What does not hang on the versions of libraries (DDS, firmware, processes) is left to `make test`.
JAZZY := test/rx90_sim test/rx90_controller test/rx90_common/bags test/rx90_common/friction test/rx90_common/description \
  test/rx90_emulator/loop test/rx90_emulator/identification
test-jazzy: environment-jazzy
	@.venv-jazzy/bin/python -m tools.digests
	@.venv-jazzy/bin/python -m pytest -n 2 --dist worksteal -m "not ros and not firmware" \
	  $(or $(ARGS),$(JAZZY))

# A warning is an error: a link that leads nowhere, a page that no other leads to, a notebook that does not run.
docs: environment-docs
	@OPENBLAS_NUM_THREADS=1 $(BIN)/python -m sphinx -W --keep-going -q -d build/doctrees -b html docs out/docs $(ARGS)
	@echo out/docs/index.html

firmware:
	@$(MAKE) --no-print-directory -C firmware

bench: environment-dev
	@$(BIN)/python -m benchmarks $(ARGS)

lint: environment-dev
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/mypy
	@$(BIN)/python -m tools.habits

clean:
	@rm -rf .venv .venv-jazzy build install log *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@find . -name __pycache__ -type d -prune -exec rm -rf {} +

environment-run environment-dev environment-docs environment-jazzy: environment-%: suitable
	@"$(PYTHON)" tools/environment.py $*

packages: suitable
	@"$(PYTHON)" -m tools.packages $(if $(TESTS_REQUIRE_PACKAGES),--required)

# Asked for here, because an older interpreter cannot even parse the set-up script.
suitable:
	@"$(PYTHON)" -c 'import sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null || \
	  { echo "PYTHON=$(PYTHON) is $$("$(PYTHON)" --version 2>&1 | tail -n 1);" \
	    "accepted: CPython 3.10 to 3.13, for example PYTHON=python3.12" >&2; exit 1; }
