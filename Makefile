# Each target sets up what it needs in .venv: python3 (with venv) and a C++17 compiler are all a machine must have.
PYTHON ?= python3
system_python := $(shell command -v $(PYTHON))
JOBS ?= 2
SIGNORINI_DATA ?= $(wildcard ../shared/data/contact_problems)
export SIGNORINI_DATA

venv := .venv
bin := $(venv)/bin
site = $(shell $(bin)/python -c "import sysconfig; print(sysconfig.get_path('purelib'))")
export PATH := $(abspath $(bin)):$(PATH)
export VIRTUAL_ENV := $(abspath $(venv))
export CMAKE_BUILD_PARALLEL_LEVEL := $(JOBS)
export PYTHONDONTWRITEBYTECODE :=

cpp_files = $(shell find include src bindings tests benchmarks examples -name '*.cpp' -o -name '*.hpp')
sources := $(shell find include src bindings cmake -type f) CMakeLists.txt pyproject.toml

.PHONY: demo test test-python test-cpp test-examples bench lint format clean

## make demo: simulate the paper's stack of cubes for 2 s, print the report, leave a recording
demo: $(venv)/installed
	@$(bin)/python examples/python/demo.py

## make test: every test there is
test:
	@start=$$(date +%s); $(MAKE) --no-print-directory lint test-python test-cpp test-examples && \
	echo "make test: all passed in $$(( $$(date +%s) - start )) s"

test-python: $(venv)/installed
	$(bin)/python -m pytest -n $(JOBS)

test-cpp: test-cpp-allocation test-cpp-asan-ubsan

# No call of malloc in a warm loop: counted in the build that the Python extension came from.
test-cpp-allocation: $(venv)/installed
	$(bin)/cmake --build build/python --target allocation_tests
	$(bin)/ctest --test-dir build/python --output-on-failure --no-tests=error -L allocation

test-cpp-asan-ubsan: test-cpp-preset-asan-ubsan

# Every C++ test in a build of its own: asan-ubsan, which make test runs, release, dev.
test-cpp-preset-%: $(venv)/tools
	$(bin)/cmake --preset $* -DCMAKE_PREFIX_PATH="$(site)"
	$(bin)/cmake --build --preset $*
	ASAN_OPTIONS=detect_leaks=1 UBSAN_OPTIONS=print_stacktrace=1 $(bin)/ctest --preset $* -j $(JOBS)

# The C++ example, built against an installed copy as a user would; then the Python ones.
test-examples: $(venv)/installed
	$(bin)/cmake --install build/python --prefix build/installed --component cpp
	$(bin)/cmake -S examples/cpp -B build/example -G Ninja -DCMAKE_PREFIX_PATH="$(abspath build/installed);$(site)/cmeel.prefix"
	$(bin)/cmake --build build/example
	build/example/sliding_block
	$(bin)/python examples/python/sliding_block.py
	$(bin)/python examples/python/wipe_wall.py build/example

## make bench: a sample of each experiment, into results/; all of one: signorini experiment NAME --output DIR
bench: $(venv)/installed
	for name in convergence scaling inverse $(if $(SIGNORINI_DATA),profiles updates robustness peers); do \
	  $(bin)/signorini experiment $$name --quick --output results/$$name || exit 1; done
	for scene in boxes cube-stack humanoid spheres; do \
	  $(bin)/signorini run $$scene --duration 2 --hardest results/hardest_steps/$$scene || exit 1; done
	$(bin)/signorini experiment robustness --data results/hardest_steps --quick --output results/hardest_steps
	$(if $(SIGNORINI_DATA),,@echo "Without problem files (SIGNORINI_DATA), four of the experiments are left out.")

## make lint: formats, ruff, mypy
lint: $(venv)/installed
	@$(bin)/clang-format --dry-run --Werror $(cpp_files)
	$(bin)/ruff check .
	$(bin)/ruff format --check .
	$(bin)/mypy

format: $(venv)/tools
	$(bin)/clang-format -i $(cpp_files)
	$(bin)/ruff check --fix .
	$(bin)/ruff format .

clean:
	rm -rf build $(venv)

# uv sets up in a tenth of the time that pip takes; pip, of the system or of the environment, fetches it.
$(venv)/bin/uv:
	$(system_python) -m venv --without-pip $(venv)
	$(system_python) -m pip --python $(bin)/python install --quiet "uv>=0.5.10" || \
	  { $(bin)/python -m ensurepip && $(bin)/python -m pip install --quiet "uv>=0.5.10"; }

$(venv)/tools: pyproject.toml | $(venv)/bin/uv
	$(bin)/uv pip install --quiet --group dev
	touch $@

# Python sources are used in place (editable); the extension is built again when C++ changed.
$(venv)/installed: $(venv)/tools $(sources)
	$(bin)/uv pip install --quiet --no-build-isolation -Cbuild-dir=build/python -Ccmake.define.SIGNORINI_BUILD_TESTS=ON \
	  --editable ".[control,meshes,mjcf,peers,plots,robots,test,view]"
	$(bin)/uv pip install --quiet --no-deps "dm_control>=1.0.30" || true  # for its robot files, which tests read if they can
	touch $@
