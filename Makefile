# Two commands matter: `make fly` and `make test`. Everything they need is set up in .venv by .ci/setup.
.DEFAULT_GOAL := help
.PHONY: help setup fly docs quick test long check bench blind mutants fuzz soak attack prove firmware release clean

PLANS ?= hover sine
SPEED ?= 1
BOARD ?= auto
FUZZ_S ?= 60
FRAMES ?= 1000000
LOGS ?= 4000
CASES ?=
CLAIMS ?=
FILES ?= firmware/core
SEED ?= 1
COUNT ?= 150
PARTS ?=
PINS ?=
MINUTES ?= 60
HELI := .venv/bin/heli-host

help: ## this list
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1@\2/p' $(MAKEFILE_LIST) | awk -F@ '{printf "%-14s %s\n", $$1, $$2}'

setup: ## everything that flying, testing and measuring need, into .venv
	@.ci/setup bench

fly: ## fly the simulated helicopter: make fly [SPEED=5|max] [PLANS="hover sine"] [BOARD=due|native]
	@.ci/setup fly
	@$(HELI) fly $(PLANS) --sil --board $(BOARD) --speed $(SPEED)

docs: ## build the site: build/docs/index.html; any warning or broken link fails
	@.ci/setup docs
	@.venv/bin/python -m sphinx --quiet --fail-on-warning --keep-going --fresh-env --builder html docs build/docs
	@echo "open build/docs/index.html"

quick: ## the tests that are quick each: what one types after an edit
	@.ci/test quick

test: ## all tests, and beside them style, types, static analysis and a short fuzzing
	@.ci/test

long: ## the same, with every claim about many samples at its full length
	@.ci/test long

check: ## style, types and static analysis only
	@.ci/setup test
	@.ci/check

bench: ## measure what the project promises: bench.json and a table; or some: make bench PARTS="due page"
	@.ci/setup bench
	@.venv/bin/python -m tests.bench $(PARTS)

blind: ## hide effects in flights, see whether diagnosis finds them: blind.json; goes on where it was stopped
	@.ci/setup test
	@.venv/bin/python -m heli_benchmark $(CASES)

mutants: ## small changes in the flight code that no test notices: make mutants [FILES=upload.cpp] [SEED=1] [COUNT=150]
	@.ci/setup test
	@.venv/bin/python -m tests.mutants --files $(FILES) --seed $(SEED) --count $(COUNT)

fuzz: ## fuzz the board, the host and its logs: make fuzz [FUZZ_S=60] [FRAMES=1000000] [LOGS=4000]; needs clang
	@.ci/setup test
	@.ci/fuzz $(FUZZ_S)
	@.venv/bin/python -m tests.link.fuzz_host $(FRAMES)
	@.venv/bin/python -m tests.log.fuzz_log $(LOGS)

soak: ## keep a live page busy, see what is lost, how memory grows, how old a status gets: make soak [MINUTES=60] [SEED=1]
	@.ci/setup test
	@.venv/bin/python -m tests.stress soak --minutes $(MINUTES) --seed $(SEED)

attack: ## faulty links, serial trouble, damaged logs, hostile clients and laws: make attack [SEED=1] [COUNT=150]
	@.ci/setup test
	@.venv/bin/python -m tests.stress attack --seed $(SEED) --count $(COUNT)

prove: ## prove claims about the flight code for all inputs: make prove [CLAIMS="parser"]; Linux on x86-64
	@.ci/setup test
	@.venv/bin/python firmware/proofs/prove.py $(CLAIMS)

firmware: ## build what is flashed to the Due: make firmware [PINS=my.toml, for another wiring]
	@.ci/setup firmware
	@.venv/bin/python firmware/pio/build.py $(if $(PINS),--pins "$(PINS)") run -e due

release: ## check what a release needs, build wheel and source archive into dist/; publishes nothing
	@.ci/setup test
	@.venv/bin/python .ci/release.py

clean: ## remove .venv and everything built; flights/ stays
	rm -rf .venv build dist bench.json blind.json .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
