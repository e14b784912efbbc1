# make help lists the targets. Everything runs in .venv, which make prepares.

PYTHON ?= python3
ROS ?= jazzy
VENV := .venv
RUN := $(VENV)/bin/python
STAMPS := $(VENV)/.stamps
MESSAGES := src/twinmatch_msgs
ROS_EXTRA_jazzy := ros
ROS_EXTRA_kilted := ros-kilted
ROS_EXTRA := $(ROS_EXTRA_$(ROS))
ifeq ($(ROS_EXTRA),)
$(error ROS=$(ROS): wheels exist for jazzy and kilted; make setup ROS=jazzy)
endif
# A worker that dies ends the run: its replacement may wait for ever.
PYTEST_ARGS ?= -n auto --dist loadfile --no-loadscope-reorder --max-worker-restart 0
PYTHONS ?= python3.10 python3.11 python3.12 python3.13
PYTHON_TESTS ?= tests/test_signals.py tests/sessions tests/importing tests/sampling tests/comparing tests/fitting tests/nodes/test_runner.py
SESSION ?=
BENCH_ARGS ?=
NEWEST ?=
TESTED := constraints/$(ROS).txt

# One thread per process: the matrices are small, and sums keep their order from run to run.
export OMP_NUM_THREADS := 1
export OPENBLAS_NUM_THREADS := 1
export MKL_NUM_THREADS := 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_ROOT_USER_ACTION := ignore

# A sourced ROS 2 or another environment's Python must not leak into this one.
unexport PYTHONPATH PYTHONHOME AMENT_PREFIX_PATH ROS_DISTRO ROS_VERSION ROS_PYTHON_VERSION RMW_IMPLEMENTATION
unexport _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH
# Python keeps what it has compiled; otherwise each of the many processes would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE

INSTALL := $(if $(NEWEST),,CONSTRAINTS=$(TESTED)) sh .ci/install.sh $(RUN)
VERSIONS := $(STAMPS)/versions-$(if $(NEWEST),newest,tested)

.PHONY: help setup setup-test debian-tools test test-long check demo bench docs dist pythons constraints clean
.DELETE_ON_ERROR:

help:
	@echo "make setup                prepare $(VENV) (PYTHON=python3.12 picks the interpreter, 3.10 to 3.13;"
	@echo "                          ROS=kilted uses that ROS 2 instead of jazzy, NEWEST=1 what the registry serves"
	@echo "                          today instead of the tested versions in constraints/)"
	@echo "make setup-test           setup, then the tools of the tests: a browser, the simulated Arduino, colcon"
	@echo "make test                 setup-test, then every check and test (PYTEST_ARGS='tests/plants -x' picks some)"
	@echo "make test-long            setup-test, then the few tests that take long: endurance, other installations"
	@echo "make check                setup-test, then only ruff, mypy and import-linter"
	@echo "make demo                 setup, then run the live graph on a virtual rig (SESSION=path plays a session instead)"
	@echo "make bench                setup and the peers, then compare speeds (BENCH_ARGS='--quick nu_gap' picks)"
	@echo "make docs                 setup-test, then the pages of docs/ as a site in build/docs"
	@echo "make dist                 setup, then wheels of twinmatch and its messages in dist/, to install without a clone;"
	@echo "                          with machine code, so that no first run compiles"
	@echo "make pythons              setup-test and PYTHON_TESTS with each of PYTHONS that is installed, in build/<python>"
	@echo "make constraints          setup, then today's versions into constraints/; make test says whether they are good"
	@echo "make clean                remove $(VENV) and everything built"

setup: $(STAMPS)/messages $(STAMPS)/compiled
	@:

# Debian packages come over the network while the processor compiles.
setup-test: $(STAMPS)/test
	@$(MAKE) --no-print-directory -j2 setup $(STAMPS)/compiled-tests debian-tools

debian-tools: $(addprefix $(STAMPS)/,board broker browser workspace)
	@:

test: setup-test
	$(RUN) -m pytest -m "not long" $(PYTEST_ARGS)

test-long: setup-test
	$(RUN) -m pytest -m long $(PYTEST_ARGS)

check: setup-test
	$(RUN) -m pytest -q tests/packaging/test_house.py

demo: setup
	$(RUN) launch_scripts/demo.py $(SESSION)

bench: setup $(STAMPS)/peers
	$(RUN) -m benchmarks $(BENCH_ARGS)

docs: setup-test
	$(RUN) -m sphinx -q -W --keep-going docs build/docs
	@echo "docs: build/docs/index.html"

dist: setup
	@rm -rf dist build/lib build/bdist.* $(MESSAGES)/build  # or modules deleted since would be packed
	@$(RUN) -m pip --quiet wheel --no-build-isolation --no-deps --wheel-dir dist . ./$(MESSAGES)
	@echo "dist: compiling what a first run would wait for (a minute)"
	@$(RUN) .ci/ready_wheel.py dist/twinmatch-*.whl
	@echo "dist: $$(ls dist | tr '\n' ' ')"

pythons:
	@for python in $(PYTHONS); do \
		if ! $$python -c "" 2>/dev/null; then echo "pythons: $$python is not installed; skipped"; continue; fi; \
		$(MAKE) --no-print-directory setup-test VENV=build/$$python PYTHON=$$python && \
		build/$$python/bin/python -m pytest -q $(PYTHON_TESTS) || exit 1; \
	done

# Of all extras, and for every Python that check_machine.py lets pass.
constraints: setup
	@for of in jazzy:ros kilted:ros-kilted; do \
		echo "constraints: constraints/$${of%%:*}.txt"; \
		printf 'uv\nwheel\n' | $(RUN) -m uv pip compile --quiet --upgrade --universal --python-version 3.10 \
			--no-header --no-annotate --output-file constraints/$${of%%:*}.txt \
			--extra $${of#*:} --extra test --extra bench pyproject.toml - || exit 1; \
	done

clean:
	rm -rf $(VENV) build install log dist $(MESSAGES)/build src/*.egg-info $(MESSAGES)/*.egg-info
	rm -rf .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	find src tests launch_scripts benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# The stamps record what .venv holds; each is written after its step has succeeded.
$(STAMPS)/venv:
	@$(PYTHON) .ci/check_machine.py
	@echo "setup: making $(VENV) with $$($(PYTHON) --version)"
	@$(PYTHON) -m venv $(VENV)
	@mkdir -p $(STAMPS) && touch $@

# Wheels of two releases share names and folders, so one set is removed before the other is installed.
$(STAMPS)/ros-$(ROS): | $(STAMPS)/venv
	@! ls $(STAMPS)/ros-* >/dev/null 2>&1 || \
		$(RUN) -m pip list --format=freeze 2>/dev/null | sed -n 's/^\(ros-[^=]*\|twinmatch[-_]msgs\)[= ].*/\1/p' | \
		xargs -r $(RUN) -m pip --quiet uninstall --yes
	@rm -f $(STAMPS)/ros-*
	@touch $@

# Which versions are wanted: those of the constraints file, or the newest.
$(VERSIONS): | $(STAMPS)/venv
	@rm -f $(STAMPS)/versions-*
	@touch $@

$(STAMPS)/versions-tested: $(TESTED)

$(STAMPS)/dependencies: $(VERSIONS) pyproject.toml setup.py setup.cfg package.xml $(wildcard config/*) $(STAMPS)/ros-$(ROS) | $(STAMPS)/venv
	@echo "setup: installing twinmatch with ROS 2 ($(ROS)) (half a minute)"
	@$(INSTALL) --editable '.[$(ROS_EXTRA),run]'
	@touch $@

$(STAMPS)/messages: $(wildcard $(MESSAGES)/msg/*.msg $(MESSAGES)/srv/*.srv) $(addprefix $(MESSAGES)/,setup.py pyproject.toml package.xml) $(STAMPS)/dependencies
	@echo "setup: building the ROS messages (half a minute)"
	@$(RUN) .ci/check_machine.py
	@rm -rf build/messages
	@$(RUN) -m pip --quiet wheel --no-index --no-build-isolation --no-deps --wheel-dir build/messages ./$(MESSAGES)
	@$(RUN) -m pip --quiet install --no-index --no-deps --force-reinstall build/messages/*.whl
	@touch $@

$(STAMPS)/test: $(STAMPS)/dependencies
	@echo "setup: installing the tools of the tests (half a minute)"
	@$(INSTALL) --editable '.[$(ROS_EXTRA),test]'
	@touch $@

$(STAMPS)/peers: $(STAMPS)/test
	@echo "bench: installing the peers (a minute)"
	@$(INSTALL) --editable '.[$(ROS_EXTRA),test,bench]'
	@touch $@

$(STAMPS)/board $(STAMPS)/broker $(STAMPS)/browser $(STAMPS)/workspace: .ci/debian_tools.sh | $(STAMPS)/venv
	@sh .ci/debian_tools.sh $(@F)
	@touch $@

# apt-get installs for one at a time.
$(STAMPS)/broker: | $(STAMPS)/board
$(STAMPS)/browser: | $(STAMPS)/broker
$(STAMPS)/workspace: | $(STAMPS)/browser

# The plants' equations and numba's machine code are cached: no first run has to wait.
$(STAMPS)/compiled: $(shell grep -rl compiled src/twinmatch --include=*.py) $(wildcard src/twinmatch/plants/*.py) $(STAMPS)/messages
	@echo "setup: compiling the plants' equations and the inner loops (a minute)"
	@$(RUN) -m twinmatch.cli prepare >/dev/null
	@touch $@
	@echo "setup: done"

# Tests whose kernels nothing else uses, and all that pytest rewrites when it collects tests: each worker of a
# first run would compile them again. What fails here fails in make test, which says so.
$(STAMPS)/compiled-tests: $(STAMPS)/compiled $(STAMPS)/test
	@echo "setup: compiling what only tests use (half a minute)"
	@$(RUN) -m pytest -q -n 2 -k "test_box_jenkins or docs/health.md or docs/fmu.md" >/dev/null 2>&1 || true
	@touch $@
