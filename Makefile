# Two commands: `make demo` shows what this is for, `make test` proves that it works. Both install into .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed

.PHONY: demo test lint bench clean

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "MeshSplatBench needs Python 3.11 or newer; say which with make PYTHON=python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)

# The peers of the cross-check and the test tools, all from PyPI; the core alone needs none of them.
$(STAMP): pyproject.toml | $(BIN)/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[crosscheck,test]'
	@touch $@

demo: $(STAMP)
	@echo "== From a trained checkpoint to an asset, without torch: msb export"
	@$(BIN)/msb export --force data_stubs/checkpoint out/demo/checkpoint.triasset
	@echo
	@echo "== What an asset holds: msb info"
	@$(BIN)/msb info data_stubs/splat_like.triasset
	@echo
	@echo "== Is it structurally usable, and do the peers agree? msb-audit --paper --cross-check"
	@$(BIN)/msb-audit --paper --cross-check data_stubs/splat_like.triasset
	@echo
	@echo "== What it looks like, on both tiers: msb render"
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white -o out/demo/standard data_stubs/splat_like.triasset
	@$(BIN)/msb render --force --cameras data_stubs/views.json --background white --tier dedicated -o out/demo/dedicated out/demo/checkpoint.triasset
	@echo
	@echo "== As any engine takes it: msb convert"
	@$(BIN)/msb convert --force data_stubs/splat_like.triasset out/demo/splat_like.glb
	@$(BIN)/msb-audit --quiet --force --elements out/demo/offending.vtp data_stubs/splat_like.triasset
	@ls -l out/demo

test: $(STAMP)
	$(BIN)/python -m pytest -n auto --dist worksteal

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
