# Two commands matter: `make fly` and `make test`. Everything they need is set up in .venv by .ci/setup.
.DEFAULT_GOAL := help
.PHONY: help setup fly web docs quick test long check bench blind mutants fuzz soak attack prove firmware release clean

PLANS ?= hover sine
SPEED ?= 1
BOARD ?= auto
FUZZ_S ?= 60
FRAMES ?= 1000000
LOGS ?= 4000
CASES ?=
CLAIMS ?=
FILES ?= firmware/core
TESTS ?=
KINDS ?=
CHECKS ?=
SEED ?= 1
COUNT ?= 150
PARTS ?=
PINS ?=
MINUTES ?= 60
HELI := .venv/bin/heli-host

help: ## list the targets
	@sed -n 's/^\([a-z]*\):.*## \(.*\)/  make \1@\2/p' $(MAKEFILE_LIST) | awk -F@ '{printf "%-15s %s\n", $$1, $$2}'

setup: ## install everything for flying, tests and benchmarks into .venv
	@.ci/setup bench

fly: ## fly the simulated helicopter: make fly [SPEED=5|max] [PLANS="hover sine"] [BOARD=due|native]
	@.ci/setup fly
	@$(HELI) fly $(PLANS) --sil --board $(BOARD) --speed $(SPEED)

web: ## write build/web/heli-lab.html, a page that flies in a browser
	@.ci/setup fly
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check 'ziglang>=0.14'
	@$(HELI) web --output build/web/heli-lab.html

docs: ## build the site in build/docs/index.html; a warning or a broken link fails
	@.ci/setup docs
	@.ci/site

quick: ## run the fast tests; use it after each edit
	@.ci/test quick $(TESTS)

test: ## run all tests, style, types, static analysis and a short fuzzing; or some tests: make test [TESTS=tests/link]
	@.ci/test all $(TESTS)

long: ## run the same with the statistical tests at full length
	@.ci/test long $(TESTS)

check: ## run style, types and static analysis only
	@.ci/setup test
	@.ci/check

bench: ## measure speed and accuracy into bench.json, with a table: make bench [PARTS="due page"]
	@.ci/setup bench
	@.venv/bin/python -m tests.bench $(PARTS)

blind: ## score the diagnosis on flights with hidden effects, into blind.json; continues an interrupted run
	@.ci/setup test
	@.venv/bin/python -m heli_benchmark $(CASES)

mutants: ## list small changes of the flight code that no test notices: make mutants [FILES=upload.cpp] [SEED=1] [COUNT=150]
	@.ci/setup test
	@.venv/bin/python -m tests.mutants --files $(FILES) --seed $(SEED) --count $(COUNT) $(if $(TESTS),--tests $(TESTS))

fuzz: ## fuzz board, host and logs: make fuzz [FUZZ_S=60] [FRAMES=1000000] [LOGS=4000]; needs clang
	@.ci/setup test
	@.ci/fuzz $(FUZZ_S)
	@.venv/bin/python -m tests.link.fuzz_host $(FRAMES)
	@.venv/bin/python -m tests.log.fuzz_log $(LOGS)

soak: ## keep a dashboard busy, and measure losses, memory and delays: make soak [MINUTES=60] [SEED=1]
	@.ci/setup test
	@.venv/bin/python -m tests.stress soak --minutes $(MINUTES) --seed $(SEED)

attack: ## attack with faulty links, serial trouble, damaged logs, hostile clients and laws: make attack [SEED=1] [COUNT=150] [KINDS=logs]
	@.ci/setup test
	@.venv/bin/python -m tests.stress attack --seed $(SEED) --count $(COUNT) $(if $(KINDS),--only $(KINDS))

prove: ## prove claims about the flight code for all inputs: make prove [CLAIMS="parser duty:STEP"]; Linux on x86-64
	@.ci/setup test
	@.venv/bin/python firmware/proofs/prove.py $(CLAIMS)

firmware: ## build the firmware of the Due: make firmware [PINS=my.toml, for another wiring]
	@.ci/setup firmware
	@.venv/bin/python firmware/pio/build.py $(if $(PINS),--pins "$(PINS)") run -e due

release: ## check what a release needs, and build wheel and source archive in dist/; publishes nothing: make release [CHECKS=citation]
	@.ci/setup test
	@.venv/bin/python .ci/release.py $(CHECKS)

clean: ## remove .venv and everything built; flights/ stays
	rm -rf .venv build dist bench.json blind.json blind.png .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
