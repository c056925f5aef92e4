# Every target does what it needs first: a fresh clone needs nothing but Python 3.11, g++, cmake and make.
.DEFAULT_GOAL := help
.PHONY: help install dev system demo test thorough quick sanitize scalar check check-types check-imports check-lint \
  check-python check-native format bench train faults wheel screenshots docs lock clean
VENV   := .venv
BIN    := $(VENV)/bin
SOURCES := $(wildcard native/*.* native/*/*)
NATIVE := CMakeLists.txt pyproject.toml $(SOURCES)
export PIP_DISABLE_PIP_VERSION_CHECK := 1
# Many tests start the program, which takes twice as long where its modules are compiled anew.
export PYTHONDONTWRITEBYTECODE :=
# uv installs in a sixth of pip's time; where it cannot, such as from an index that only pip's settings name, pip does.
# What is imported is compiled then; compiling every module of every package takes longer than installing them.
install_lock = { [ -x $(BIN)/uv ] && $(BIN)/uv pip install --quiet --no-config --python $(BIN)/python --require-hashes -r $(1); } || \
  $(BIN)/python -m pip install --quiet --no-compile --require-hashes -r $(1)

help: ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 12

$(VENV)/.made: tools/venv.sh requirements/uv.lock
	sh tools/venv.sh $(VENV)
	-$(BIN)/python -m pip install --quiet --no-compile --require-hashes -r requirements/uv.lock
	@touch $@

$(VENV)/.run: $(VENV)/.made requirements/run.lock
	$(call install_lock,requirements/run.lock)
	@touch $@

$(VENV)/.dev: $(VENV)/.run requirements/dev.lock
	$(call install_lock,requirements/dev.lock)
	@touch $@

# An installation in place needs no level that its own processor does not run; wheels have all of them, so that CMake's
# cache of the former lies in a folder of its own.
LEVELS := $(if $(shell grep -m1 avx512bw /proc/cpuinfo 2>/dev/null),,$(if $(filter x86_64,$(shell uname -m)),v2;v3))

$(VENV)/.native: $(VENV)/.run $(NATIVE)
	$(BIN)/python -m pip install --quiet --no-build-isolation --no-deps \
	  -C 'build-dir=build/in_place/{wheel_tag}' -C 'cmake.define.BELTSCAPE_LEVELS=$(LEVELS)' -C cmake.define.BELTSCAPE_EMULATION=ON --editable .
	@touch $@

install: $(VENV)/.native ## .venv with the beltscape program in .venv/bin

dev: $(VENV)/.dev $(VENV)/.native ## .venv with the program, editable, and the tools that develop and test it

system: dev ## Debian packages for GenICam cameras, and for tests with a browser and simulated cameras (as root)
	apt-get update
	DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends chromium mosquitto gir1.2-aravis-0.8 \
	  libaravis-0.8-0 libgirepository1.0-dev libcairo2-dev pkg-config iproute2 fonts-wqy-microhei
	$(BIN)/python -m pip install --quiet 'pygobject>=3.42,<3.51'

demo: install ## the whole chain on a small rig; writes out/demo/report.html
	$(BIN)/beltscape demo --out out/demo

test: dev ## every test
	$(BIN)/python -m pytest

thorough: dev ## every test, every property with all its examples, every case: every night and before a release
	BELTSCAPE_THOROUGH=1 $(BIN)/python -m pytest

quick: dev ## the tests that take no capture, no browser and no cameras: under a minute
	$(BIN)/python -m pytest -m "not slow and not browser and not cameras and not gpu"

# The sanitized build stands apart: its own folder, found through PYTHONPATH; -S leaves the editable install out.
SANITIZED := build/sanitize
sanitize: dev ## the tests of the kernels under the address and undefined-behaviour sanitizers
	$(BIN)/python -m pip install --quiet --no-build-isolation --no-deps --upgrade --target $(SANITIZED)/site \
	  -C build-dir=$(SANITIZED)/cmake -C cmake.define.BELTSCAPE_SANITIZE=ON -C install.strip=false .
	site=$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') && \
	LD_PRELOAD="$$(g++ -print-file-name=libasan.so) $$(g++ -print-file-name=libstdc++.so)" PYTHONMALLOC=malloc \
	  ASAN_OPTIONS=detect_leaks=0 UBSAN_OPTIONS=print_stacktrace=1 PYTHONPATH=$(SANITIZED)/site:$$site \
	  $(BIN)/python -S -m pytest -n0 --capture=sys tests/kernels --ignore tests/kernels/test_cuda_compile.py

scalar: dev ## the tests of the kernels without vectors, one number at a time
	$(BIN)/python -m pip install --quiet --no-build-isolation --no-deps --upgrade --target build/scalar/site \
	  -C build-dir=build/scalar/cmake -C cmake.define.BELTSCAPE_LEVELS=scalar .
	site=$$($(BIN)/python -c 'import sysconfig; print(sysconfig.get_path("purelib"))') && \
	PYTHONPATH=build/scalar/site:$$site $(BIN)/python -S -m pytest -n0 tests/kernels --ignore tests/kernels/test_cuda_compile.py

check: dev ## format, lint, types, import floors: side by side, each failure shown
	@$(MAKE) --no-print-directory --keep-going --output-sync --jobs check-types check-imports check-lint check-python check-native

check-types:
	$(BIN)/pyrefly check --output-format min-text
check-imports:
	$(BIN)/lint-imports
check-lint:
	$(BIN)/ruff check .
check-python:
	$(BIN)/ruff format --check .
check-native:
	$(BIN)/clang-format --dry-run --Werror $(SOURCES)

format: dev ## put Python and C++ into shape
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .
	$(BIN)/clang-format -i $(SOURCES)

bench: dev ## accuracy and speed against OpenCV; writes benchmarks/RESULTS.md, and the manual's tables of it
	$(BIN)/python benchmarks/run.py
	$(BIN)/python tools/write_figures.py

train: dev ## fit every network that ships to simulated captures, from their seeds (hours; goes on where it was; WORKERS=4)
	$(BIN)/python -m pip install --quiet 'torch==2.15.0'
	cd tools && ../$(BIN)/python -m training $(if $(ONLY),--only $(ONLY)) $(if $(WORKERS),--workers $(WORKERS))
	$(BIN)/python tools/write_model_cards.py

faults: dev ## play every fault to the running system, against exact truth; writes benchmarks/FAULTS.md (an hour)
	cd benchmarks && ../$(BIN)/python -m faults

# In an environment of its own: the compiler alone takes 400 MB. The wheel of the stable ABI, for 3.12 and newer:
#   PYTHON=python3.12 make wheel VENV=.venv312
$(VENV)-wheel/.made: requirements/wheel.lock
	sh tools/venv.sh $(VENV)-wheel
	$(VENV)-wheel/bin/python -m pip install --quiet --require-hashes -r requirements/wheel.lock
	@touch $@

wheel: $(VENV)-wheel/.made ## dist/: the wheel for glibc 2.28 and newer, and the source archive
	$(VENV)-wheel/bin/python tools/build_wheel.py dist

screenshots: dev ## docs/images/operator_*.png and passing.webp anew, from a simulated plant in Chromium
	$(BIN)/python -m tests.service.page.take_screenshots

docs: dev ## the manual as a web site in site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

lock: dev ## resolve the dependencies anew
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra build --extra simulate --extra live pyproject.toml -o requirements/run.lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra build --extra simulate --extra live --extra export --extra modbus --extra mqtt --extra site --extra opcua --extra reports --extra certificates --extra cluster --extra dev \
	  -c requirements/run.lock pyproject.toml -o requirements/dev.lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header --extra gpu -c requirements/run.lock pyproject.toml -o requirements/gpu.lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header -c requirements/run.lock requirements/wheel.in -o requirements/wheel.lock
	$(BIN)/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --no-header -c requirements/dev.lock requirements/uv.in -o requirements/uv.lock

clean: ## back to a fresh clone
	rm -rf $(VENV) $(VENV)-wheel build dist out site .pytest_cache .ruff_cache .hypothesis
