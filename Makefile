# Everything needs only Python 3.10 or later, make and PyPI. The environment is made by the first target that needs it.

PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11 python3.10; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 10))' 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
JOBS ?= 2
PYTHONS ?= python3.10 python3.11 python3.12 python3.13
PATHS := expert modules knowledge tests examples benchmarks docs

# The stamp carries a hash of what the environment is made of, so that a changed lock file renews it.
HASH := $(shell cat requirements.lock pyproject.toml | cksum | cut -d ' ' -f 1)
STAMP := $(VENV)/.terrex-$(HASH)

# Run one tool; its output is shown only when it fails.
quiet = @printf '%s ... ' '$(1)'; if out=$$($(2) 2>&1); then echo ok; else echo FAILED; printf '%s\n' "$$out"; exit 1; fi

.PHONY: help env demo test lint unit doctest property property-engines bench bench-accuracy bench-score bench-checks calibrate-confidence bench-causes bench-facts bench-inference bench-field bench-ground-plane bench-matching bench-pandora docs mutation schema fmt lock wheel clean bench-terrain
.DEFAULT_GOAL := help

help:  ## Show the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1\t/p' Makefile | expand -t 18

env: $(STAMP)  ## Create or renew the environment in .venv from requirements.lock

$(STAMP): requirements.lock pyproject.toml
	@test -n '$(PYTHON)' || { echo 'Python 3.10 or later is needed and none was found; install it or name it: make PYTHON=/path/to/python3'; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv --clear $(VENV) || \
		{ echo 'Python could not make an environment; on Debian and Ubuntu: apt install python3-venv'; exit 1; }
	@echo 'Installing the environment into $(VENV), a few minutes the first time'
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --require-hashes -r requirements.lock
	@$(BIN)/python -m pip install -qq --disable-pip-version-check --no-deps --no-build-isolation -e .
	@rm -f $(VENV)/.terrex-*
	@touch $@

demo: $(STAMP)  ## Reconstruct a real pair, the same pair degraded, and a rendered terrain; results in demo-out/
	@$(BIN)/python examples/demo.py

test: lint unit doctest  ## Run everything: formatter, linter, types, import contracts, tests, examples in docstrings

lint: $(STAMP)  ## Check formatting, style, types and import contracts
	$(call quiet,ruff format,$(BIN)/ruff format --check $(PATHS))
	$(call quiet,ruff check,$(BIN)/ruff check $(PATHS))
	$(call quiet,mypy,$(BIN)/mypy)
	$(call quiet,import contracts,$(BIN)/lint-imports)

unit: $(STAMP)  ## Run the unit, property and end-to-end tests
	@$(BIN)/pytest -n $(JOBS) -rs --no-header

doctest: $(STAMP)  ## Run the examples in the docstrings
	$(call quiet,examples in docstrings,$(BIN)/pytest --doctest-modules -p no:cacheprovider expert modules)

property: $(STAMP)  ## Run the property tests with many more examples, drawn anew
	@HYPOTHESIS_PROFILE=thorough $(BIN)/pytest -n $(JOBS) --no-header -m hypothesis

property-engines: $(STAMP)  ## Compare experta, compiled and CLIPS on 20 000 random rule bases, and the literal semantics on half as many
	@TERREX_CASES=20000 HYPOTHESIS_PROFILE=thorough $(BIN)/pytest -s --no-header tests/expert/engine/test_agreement.py

.PHONY: versions
versions:  ## Compare decisions on recorded facts over the supported Pythons that are installed (environments in build/)
	@mkdir -p build; for python in $(PYTHONS); do \
		$$python -c '' 2>/dev/null || { echo "$$python is not installed and was left out"; continue; }; \
		env=build/versions/$$($$python -c 'import sys; print("%d.%d" % sys.version_info[:2])'); \
		test -x $$env/done || { $$python -m venv --clear $$env && $$env/bin/python -m pip install -qq \
			--disable-pip-version-check --require-hashes -r requirements.lock && ln -s bin/python $$env/done; } || exit 1; \
		PYTHONPATH=. $$env/bin/python tests/expert/engine/determinism.py tests/expert/engine/recorded/*.json > $$env.txt || exit 1; \
		echo "$$env"; cat $$env.txt; done; \
	test $$(cat build/versions/*.txt | sort -u | wc -l) = $$(cat $$(ls build/versions/*.txt | head -1) | wc -l) \
		|| { echo 'the Pythons disagree'; exit 1; }

bench: $(STAMP)  ## Measure accuracy and the share of time per pair, and the elevation error on rendered terrain
	@$(BIN)/python -m benchmarks
	@$(BIN)/python -m benchmarks.terrain --seeds 3 --distortions clean

bench-terrain: $(STAMP)  ## Measure elevation, uncertainty and hazards on rendered terrain against the bars, and the speed
	@$(BIN)/python -m benchmarks.terrain $(ARGS)
	@$(BIN)/python -m benchmarks.terrain_speed

.PHONY: bench-writers
bench-writers: $(STAMP)  ## Measure the writers of terrain products beside those of well-known libraries
	@$(BIN)/python -m benchmarks.writers $(ARGS)

bench-field: $(STAMP)  ## Reconstruct rover pairs and measure how level their ground is (needs TERREX_DATA)
	@$(BIN)/python -m benchmarks.field_pairs $(ARGS)

bench-ground-plane: $(STAMP)  ## Measure on rendered terrain whether the fitted ground plane states its uncertainty honestly
	@$(BIN)/python -m benchmarks.ground_plane
bench-facts: $(STAMP)  ## Compare facts with simulated truth: bias, spread, disparity range; ARGS=--time for CPU time per probe
	@$(BIN)/python -m benchmarks.facts $(ARGS)

bench-causes: $(STAMP)  ## Name simulated causes of differences: confusion matrix over development pairs (needs TERREX_DATA)
	@$(BIN)/python -m benchmarks.causes $(ARGS)

bench-accuracy: $(STAMP)  ## Measure terrex and 30 fixed configurations over development pairs x distortions; ARGS=--pandora ... (needs TERREX_DATA)
	@$(BIN)/terrex evaluate $(or $(TERREX_DATA),$(error no data: set TERREX_DATA)) --split dev --out build/evaluation --jobs $(JOBS) $(ARGS)

bench-candidates: $(STAMP)  ## Choose among variants of the rules, on all scenes and with the scene left out (needs TERREX_DATA)
	@$(BIN)/terrex evaluate $(or $(TERREX_DATA),$(error no data: set TERREX_DATA)) --split dev --profile balanced --range given --only none \
	  $(foreach file,$(wildcard examples/evidence/candidates/*.yaml),--candidate $(file)) --out build/evaluation --jobs $(JOBS) $(ARGS)

bench-matching: $(STAMP)  ## Measure the matchers: accuracy, time, memory, scaling, pixel locking (needs TERREX_DATA)
	@$(BIN)/python -m benchmarks.matching $(ARGS)
	@$(BIN)/python -m benchmarks.matching_scaling --plot build/matching-scaling.png

bench-pandora: build/pandora/bin/pandora  ## Install CNES Pandora into an environment of its own, for bench-matching

build/pandora/bin/pandora:
	@mkdir -p build && $(PYTHON) -m venv build/pandora
	@build/pandora/bin/python -m pip install -qq --disable-pip-version-check pandora==1.9.0 pandora-plugin-libsgm==1.5.8

bench-score: $(STAMP)  ## Measure the no-reference score: picking among configurations, scenes left out (needs TERREX_DATA; half an hour the first time, ARGS=--write fits it)
	@$(BIN)/python -m benchmarks.quality_score $(ARGS)

bench-checks: $(STAMP)  ## Measure what each check, filter and the quality probe cost beside the matcher
	@$(BIN)/python -m benchmarks.matching_cost $(ARGS)

calibrate-confidence: $(STAMP)  ## Fit the tables of confidence and uncertainty to the runs of bench-score, and write them
	@$(BIN)/python -m benchmarks.calibrate_confidence --write $(ARGS)

bench-inference: $(STAMP)  ## Measure inference: shipped and generated rules, experta, compiled and CLIPS; growth over 10 000 pairs
	@$(BIN)/python -m benchmarks.inference
	@$(BIN)/python -m benchmarks.inference --memory

.PHONY: bench-budgets
bench-budgets: $(STAMP)  ## Measure how often time and memory budgets are kept, and what they cost (needs TERREX_DATA)
	@$(BIN)/python -m benchmarks.budgets $(ARGS)

.PHONY: bench-batch
bench-batch: $(STAMP)  ## Measure long runs: throughput of 1 and 2 workers, overhead, 50 kills, growth over 5000 pairs
	@$(BIN)/python -m benchmarks.batch $(ARGS)

.PHONY: bench-correction bench-correction-rules
bench-correction: $(STAMP)  ## Measure the time of every operator of correction
	@$(BIN)/python -m benchmarks.correction $(ARGS)

bench-correction-rules: $(STAMP)  ## Measure the rules of correction before a fixed matcher (needs TERREX_DATA)
	@$(BIN)/python -m benchmarks.correction_rules $(ARGS)

.PHONY: bench-report
bench-report: $(STAMP)  ## Measure what the reports of a pair cost
	@$(BIN)/python -m benchmarks.report $(ARGS)

.PHONY: bench-rules
bench-rules: $(STAMP)  ## Measure the time to check rule files of 100 and 1000 rules
	@$(BIN)/python -m benchmarks.rule_check

.PHONY: fuzz
fuzz: $(STAMP)  ## Feed the reader of rule files thousands of inputs drawn anew, and the largest of every kind
	@TERREX_FUZZ=3000 $(BIN)/pytest -n $(JOBS) --no-header tests/expert/rules/test_load_fuzz.py

mutation: $(STAMP)  ## Change every rule a little and check that one of its cases fails
	@$(BIN)/python tests/expert/mutation.py

schema: $(STAMP)  ## Write the schemas of rule files and calibrations, for editors, and of decision.json
	@$(BIN)/terrex rules schema > knowledge/rules.schema.json
	@$(BIN)/terrex explain --schema > knowledge/decision.schema.json
	@$(BIN)/terrex calibrate --schema > docs/calibration.schema.json

docs: $(STAMP)  ## Build the documentation into site/, what is generated from the code included
	@$(BIN)/python docs/generate.py
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q
	@echo 'open site/index.html'

.PHONY: browser
browser: docs  ## Test the pages of reports, batches and the documentation in Chromium (needs Node.js 18 and Chromium; screenshots in build/browser)
	@tests/browser/prepare.sh
	@PYTHONPATH=.:tests/expert $(BIN)/python tests/browser/make_pages.py build/browser
	@cd tests/browser && node --test --test-reporter=spec *.test.mjs

fmt: $(STAMP)  ## Format code and rules, and repair what the linter can
	@$(BIN)/ruff check -q --fix $(PATHS) || true
	@$(BIN)/ruff format -q $(PATHS)
	@$(BIN)/terrex rules fmt knowledge/rules.yaml knowledge/cases/*.yaml

lock:  ## Resolve the newest versions that pyproject.toml allows into requirements.lock
	@$(PYTHON) -m venv --clear build/lock
	@build/lock/bin/python -m pip install -qq --disable-pip-version-check uv
	@build/lock/bin/uv pip compile -q --universal --python-version 3.10 --all-extras --generate-hashes --no-header \
		--no-annotate --no-emit-index-url --upgrade pyproject.toml -o build/lock/requirements.txt
	@{ sed -n '/^#/p;/^[^#]/q' requirements.lock; cat build/lock/requirements.txt; } > build/lock/requirements.lock
	@mv build/lock/requirements.lock requirements.lock

wheel: $(STAMP)  ## Build the wheel and the source distribution into dist/
	$(call quiet,build,$(BIN)/python -m build --no-isolation)
	@ls dist

clean:  ## Remove the environment and everything that was built
	rm -rf $(VENV) tests/browser/node_modules build dist site docs/generated demo-out out *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
