# Every target sets up .venv when it is missing or older than what it is made from.
#   make repro                 the whole benchmark at the size of params.yaml (the default profile)
#   make repro PROFILE=smoke   write a profile (smoke, default, patients, reference, paper or abdomen) to params.yaml first
VENV ?= .venv
PYTHON ?= python3
LEROBOT_PYTHON ?= python3.12
PROFILE ?=
SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
READY := $(VENV)/.ready
export PATH := $(abspath $(VENV))/bin:$(PATH)
# DVC runs one stage at a time. Two of it run stages that need nothing of each other, and check nothing
# that comes before them: it is there. Where one fails, make fails: the second half stops the first at
# once, the first lets the second come to its end. Whoever stops make stops both.
ALONE := dvc --wait-for-lock repro --single-item
define beside
set -m; $(ALONE) $(1) </dev/null & one=$$!; { $(2); } </dev/null & two=$$!; set +m; \
trap 'kill -- -$$one 2>/dev/null || :; kill -- -$$two 2>/dev/null || :' EXIT; wait $$two; wait $$one
endef
# Threads of oneDNN wait by spinning when they train a judge: two that share a core with other work take
# several times as long as one. Those of OpenMP wait asleep, if told to.
SHARE := $(or $(OMP_NUM_THREADS),$(shell echo $$(( ($$(getconf _NPROCESSORS_ONLN) + 1) / 2 ))))
repro: export OMP_WAIT_POLICY ?= PASSIVE
# Compiled code is kept: without it each process reads all of the tests and packages anew.
TESTS := PYTHONDONTWRITEBYTECODE= OMP_NUM_THREADS=1 pytest -n 2 --dist worksteal --ignore tests/benchmarks --ignore tests/export_envs --ignore tests/clients
# The files that have tests of a mark: to read all others takes each process longer than some of those.
marked = $$(grep -rlw --include="test_*.py" "mark.$(1)" tests)

.PHONY: help repro studio test test-docs test-docs-quick test-thorough test-fast test-instruction-sets test-exports test-clients mutants lint types bench gpu docs docs-numbers docs-reference clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' $(firstword $(MAKEFILE_LIST)) | expand -t 14

$(READY): pyproject.toml constraints.txt
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install -q --no-compile -c constraints.txt -e ".[dev]"
	touch $@

repro: $(READY) ## run the pipeline; a second run does nothing
ifneq ($(PROFILE),)
	cp racines_data/profiles/$(PROFILE).yaml params.yaml.part
	mv params.yaml.part params.yaml
endif
	dvc repro data
	$(call beside,generators,OMP_NUM_THREADS=$(SHARE) $(ALONE) encoder grader student pose)
	$(call beside,scores gallery,$(ALONE) agents evaluate patient_agents evaluate_patients evaluate_beating realism)
	dvc repro
	@test ! -f data/racines/card/patients.png || echo "patients: data/racines/card/patients.png; how agents fare on them: envs/runs/patients"
	@echo "one heart: leaderboard/LEADERBOARD.md"

test: $(READY) ## run the tests of the code
	$(TESTS) -m "not docs and not thorough and not instruction_sets"

test-docs: $(READY) ## run what the README and docs/ say, and the pages in a browser
	$(TESTS) -m docs $(call marked,docs)

test-docs-quick: $(READY) ## run the README, and of docs/ all but the pages that take long; as .ci/run does
	$(TESTS) -m "docs and not thorough" $(call marked,docs)

test-thorough: $(READY) ## run the walk-throughs, long pages of docs/, runs that are killed at any moment, every variant of the rest
	$(TESTS) -m thorough

test-instruction-sets: $(READY) ## run the contracts of rows, and draw canonical frames, on other instruction sets of the CPU
	$(TESTS) -m "instruction_sets and not thorough" $(call marked,instruction_sets)

test-fast: $(READY) ## run the tests that take seconds
	$(TESTS) -m "not docs and not thorough and not instruction_sets and not slow"

test-exports: $(READY) .venv-lerobot/.ready .venv-minari/.ready ## open exports with the real libraries
	OMP_NUM_THREADS=1 pytest -n 0 tests/export_envs

test-clients: $(READY) $(patsubst tests/clients/%.txt,.venv-%/.ready,$(wildcard tests/clients/*.txt)) ## train by other libraries, each in its environment, and time them
	OMP_NUM_THREADS=1 pytest -n 0 tests/clients -s

mutants: $(READY) ## break what the numbers rest on and see whether the tests notice; goes on where it stopped
	OMP_NUM_THREADS=1 python -m tests.mutants

# The libraries that read our exports do not fit beside ours: each has an environment of its own.
# LeRobot wants a newer Python than ours has to be; our tasks stand in its environment without what
# else we depend on. Where there is no such Python, its tests are skipped.
.venv-lerobot/.ready: tests/export_envs/lerobot.txt pyproject.toml
	@command -v $(LEROBOT_PYTHON) || { echo "no $(LEROBOT_PYTHON): LeRobot is left out; make test-exports LEROBOT_PYTHON=… names one of 3.12 or later" >&2; exit 0; }; \
	set -x; $(LEROBOT_PYTHON) -m venv --clear .venv-lerobot; \
	.venv-lerobot/bin/python -m pip install -q -r $<; \
	.venv-lerobot/bin/python -m pip install -q --no-compile --no-deps -e .; \
	touch $@

.venv-%/.ready: tests/export_envs/%.txt
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	.venv-$*/bin/python -m pip install -q -r $<
	touch $@

# Nor do all learners: beside each stands our package on its published versions, but for what the
# learner's file names.
.venv-%/.ready: tests/clients/%.txt pyproject.toml constraints.txt
	test -x .venv-$*/bin/python || $(PYTHON) -m venv .venv-$*
	grep -vixf <(sed -n 's/\[.*\]//; s/==.*/==.*/p' $<) constraints.txt > .venv-$*/constraints.txt
	.venv-$*/bin/python -m pip install -q --no-compile -c .venv-$*/constraints.txt -e ".[train]" -r $<
	touch $@

lint: $(READY) ## check style, format and spelling
	ruff check .
	ruff format --check .
	codespell

types: $(READY) ## check types
	pyright

bench: $(READY) ## measure speed; run alone, on a quiet machine
	OMP_NUM_THREADS=$$(nproc) pytest tests/benchmarks -n 0 --benchmark-only

# It sets nothing up: a machine with a GPU has its own PyTorch, and often no network.
gpu: ## measure one GPU; train the paper's agent and generators, and agents on patients; goes on where it stopped. BUDGET=25m DEVICE=cuda OUT= PARTS=
	PYTHONPATH=.:models:envs:leaderboard$${PYTHONPATH:+:$$PYTHONPATH} $(PYTHON) -m tests.benchmarks.gpu --budget $(or $(BUDGET),25m) \
	--device $(or $(DEVICE),cuda) $(if $(OUT),--out $(OUT)) $(if $(PARTS),--parts $(PARTS))

studio: $(READY) ## show boards, study and data in a browser, at http://127.0.0.1:7860
	racines studio

docs: $(READY) ## build the pages under docs/ into site/
	NO_MKDOCS_2_WARNING=1 mkdocs build --strict -q

docs-numbers: $(READY) ## draw the figures in README, docs/ and CHANGELOG anew from the committed results
	python -m tests.prose

docs-reference: $(READY) ## draw the pages of commands and settings anew from the code
	python -m tests.reference

clean: ## remove what the pipeline and the tools made, the DVC cache included; keeps .venv
	git clean -fdXq data models/runs envs/runs
	rm -rf .dvc/cache .dvc/tmp site dist build .pytest_cache .ruff_cache .benchmarks
