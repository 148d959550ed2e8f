# Two commands: `make demo` shows what this is for, `make test` proves that it works. Both install into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test engines lint bench clean

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "MeshSplatBench needs Python 3.11 or newer; say which with make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# The cross-check's peers, the viewers, a cluster and the test tools, all from PyPI; the core needs none of them.
$(STAMP): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[crosscheck,distributed,test,view]'
	@touch $@

demo: $(STAMP)
	@echo "== From a trained checkpoint to an asset, without torch: msb export"
	@$(BIN)/msb export --force data_stubs/checkpoint out/demo/checkpoint.triasset
	@echo
	@echo "== Is a mesh structurally usable, and do the peers agree? msb-audit --paper --cross-check"
	@$(BIN)/msb-audit --paper --cross-check data_stubs/splat_like.triasset
	@echo
	@echo "== What it looks like, on both tiers: msb render"
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white -o out/demo/standard data_stubs/splat_like.triasset
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white --tier dedicated -o out/demo/dedicated data_stubs/splat_like.triasset
	@echo
	@echo "== As any engine takes it: msb convert"
	@$(BIN)/msb convert --force data_stubs/splat_like.triasset out/demo/splat_like.glb
	@echo
	@echo "== Four methods on four scenes, on every path: msb run"
	@$(BIN)/msb run --jobs 2 data_stubs/protocol.toml
	@echo
	@echo "== What that says: msb report"
	@$(BIN)/msb report --force -o out/demo/report out/demo/results
	@if [ -t 1 ] && [ -n "$$DISPLAY$$WAYLAND_DISPLAY$$(command -v open)" ]; then \
	  $(BIN)/python -m webbrowser "file://$(CURDIR)/out/demo/report/index.html" >/dev/null; \
	else echo "open it in a browser: file://$(CURDIR)/out/demo/report/index.html"; fi

test: $(STAMP) engines
	$(BIN)/python -m pytest -n auto --dist worksteal

# What draws in Vulkan and in a browser, on Debian where apt-get asks nobody; without it those tests are skipped.
engines:
	@if grep -qs '^ID=debian' /etc/os-release && \
	  { ! ls /usr/share/vulkan/icd.d/*.json || ! command -v chromium; } >/dev/null 2>&1; then \
	  sudo=; [ "$$(id -u)" = 0 ] || sudo='sudo -n'; \
	  echo "installing mesa-vulkan-drivers and chromium, for the tests of engines"; \
	  { timeout 60 $$sudo apt-get -qq update; timeout 240 $$sudo env DEBIAN_FRONTEND=noninteractive \
	    apt-get -qq install --no-install-recommends mesa-vulkan-drivers chromium; } >/dev/null 2>&1 || \
	  echo "they cannot be installed here: tests of engines will be skipped" >&2; \
	fi

lint: $(STAMP)
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m mypy
	$(BIN)/python -m pytest -q tests/test_import_rules.py

bench: $(STAMP)
	$(BIN)/python -m benchmarks.audit
	$(BIN)/python -m benchmarks.export

clean:
	rm -rf $(VENV) out build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
