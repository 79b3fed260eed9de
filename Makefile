# Every target works on a fresh machine that has Python 3.10+ and make.

PYTHON ?= python3
MPY_ARCH ?= armv6m
BOARD ?=
PORT ?=

BIN := .venv/bin
PROGRAM := .venv/program
VENV := .venv/installed
TYPESHED := .venv/typeshed/merged
EMULATOR := .venv/emulator/compiled

.PHONY: release-files release-dry run test first-ring test-all mutants check fmt lint types build deploy dist clean compiled-emulator test-emulator test-senders torture torture-board bench bench-board docs pictures

run: $(PROGRAM)  ## a demonstration in the simulator
	$(BIN)/ugrbl demo

test: $(TYPESHED)  ## what a change may break, in minutes; SEED=1 for the same samples again
	$(MAKE) --no-print-directory -j3 lint types first-ring

first-ring: $(VENV)
	$(BIN)/pytest -q -n auto --dist loadgroup $(if $(SEED),--seed=$(SEED))

check: test

test-all: $(VENV)  ## all that needs neither image nor sender; SHARD=2/5 is the second of five parts; WHOLE=1 samples nothing
	$(BIN)/pytest -q -n auto --dist loadgroup --all $(if $(WHOLE),--whole) $(if $(SHARD),--shard=$(SHARD)) $(if $(SEED),--seed=$(SEED))

mutants: $(VENV)  ## COUNT small faults in the firmware: how many of them the tests find
	$(BIN)/python host_tests/support/mutants.py --count $(or $(COUNT),60) --seed $(or $(SEED),1) $(if $(ALL),--all)

fmt: $(VENV)
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

lint: $(VENV)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TYPESHED)
	$(BIN)/mypy

build: $(VENV)  ## firmware for BOARD, or all of it for MPY_ARCH, into build/; bytes per module
	$(BIN)/ugrbl build $(if $(BOARD),--board $(BOARD),--arch $(MPY_ARCH))

deploy: $(VENV)  ## firmware for BOARD onto the board at PORT, or at the only one there is
	$(BIN)/ugrbl deploy --board $(or $(BOARD),$(error which board? make deploy BOARD=rpi_pico)) $(if $(PORT),--port $(PORT))

dist: $(VENV)  ## the package, with the firmware compiled for every chip, into dist/
	$(BIN)/python -m build --no-isolation

release-files: dist  ## what a release VERSION has besides images, into dist/
	$(BIN)/python -m ugrbl.image.release dist $(VERSION)

release-dry: $(VENV)  ## a release as far as it needs no network and no tag, into dist/
	$(MAKE) release-files VERSION=

compiled-emulator: $(EMULATOR)  ## the emulated Pico three times as fast, where there is a C compiler

test-emulator: $(EMULATOR)  ## on an emulated Pico; UGRBL_UF2 names MicroPython's image for it, UGRBL_FROZEN_UF2 one with the firmware in; or CHIP=rp2350, CHIP=esp32
	UGRBL_CHIP=$(CHIP) $(BIN)/pytest -q -rs -n auto --dist loadgroup host_tests/emulator

torture: $(VENV)  ## stops at every bytecode, and random sessions: SEEDS of them, minutes to hours
	UGRBL_TORTURE=$(or $(SEEDS),500) $(BIN)/pytest -q -n auto --timeout 0 --whole host_tests/whole/test_injection.py host_tests/whole/test_torture.py host_tests/extras/test_custom_injection.py host_tests/control/test_waits_in_holds.py

torture-board: $(EMULATOR)  ## stops at random instants on an emulated Pico: INJECTIONS of them, an hour
	UGRBL_INJECTIONS=$(or $(INJECTIONS),1000) $(BIN)/pytest -q -rs -s host_tests/emulator/test_pico_injection.py

bench: $(VENV)  ## the firmware's speed on this desktop
	$(BIN)/python host_tests/bench/bench_desktop.py

bench-board: $(EMULATOR)  ## and on a board: at PORT, or emulated with the image UGRBL_UF2
	UGRBL_CHIP=$(CHIP) PORT=$(PORT) $(BIN)/python host_tests/bench/bench_board.py

test-senders: $(VENV)  ## real senders, installed into ~/.cache/ugrbl-senders, at the simulator
	$(BIN)/pytest -q -rs host_tests/senders

docs: $(VENV)  ## the tables in docs/, and the words of the page, out of the firmware's own
	$(BIN)/python -m ugrbl.docs

pictures: $(VENV)  ## and the pictures, each by its command, those of the page by its tests
	$(BIN)/python -m ugrbl.docs --pictures
	UGRBL_PICTURES=1 $(BIN)/pytest -q -rs --all host_tests/web/test_served_page.py host_tests/web/test_whole_way.py

clean:  ## all that is made, except .venv
	rm -rf build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis

# Containers often set it. Then every process that a test starts compiles all of it anew.
unexport PYTHONDONTWRITEBYTECODE

# Without isolation: else the compilers, 100 MB, would be installed a second time to build in.
# What is never imported need not be compiled: a third of the time that all this takes.
PIP := $(BIN)/pip install --quiet --disable-pip-version-check --no-compile

$(PROGRAM): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.version_info >= (3, 10) or sys.exit("ugrbl needs Python 3.10 or newer")'
	$(PYTHON) -m venv .venv
	$(PIP) 'setuptools>=77'
	$(PIP) --no-build-isolation -e .
	@touch $@

$(VENV): $(PROGRAM)
	$(PIP) --no-build-isolation -e '.[dev]'
	@touch $@

$(TYPESHED): $(VENV) $(wildcard host_tests/typeshed/*)
	$(BIN)/python host_tests/typeshed/merge.py $(@D)
	@touch $@

$(EMULATOR): $(VENV) host_tests/emulator/compile_emulator.py host_tests/emulator/xip_cache.pyx
	$(BIN)/python host_tests/emulator/compile_emulator.py $(@D)
	@touch $@
