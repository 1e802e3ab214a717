# Two commands on a fresh machine: `make identify` and `make test`; each builds the environment first where it is missing.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.built
RESULTS := results/two-mass-chain
STUDY := results/paper
PYTEST := -m pytest -q -n auto --maxprocesses 8 --dist worksteal
# one BLAS thread for each worker, compiled modules kept for the many processes that tests start, and memory that arrays
# leave kept for the next ones: a seventh of the time of a fit went into pages that glibc gave back and asked for again
KEEPING := MALLOC_MMAP_THRESHOLD_=33554432 MALLOC_TRIM_THRESHOLD_=268435456
TESTING := OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(KEEPING)

.DEFAULT_GOAL := help
.PHONY: help env identify study test test-slow test-all coverage kernels matrix docs benchmark corpus fuzz check clean

help:  ## list the targets
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

env: $(STAMP)  ## build the environment in .venv

$(STAMP): pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "linkwise needs Python 3.11 or later; $(PYTHON) is $$($(PYTHON) -V 2>&1). Try: make env PYTHON=python3.12"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
	@touch $@

identify: env  ## simulate the paper's two-mass chain at 30 dB, identify its sink, write results/
	@mkdir -p $(RESULTS)
	$(BIN)/linkwise structure bnes --dof 2 --unknown nes -o $(RESULTS)/unknown.toml
	$(BIN)/linkwise structure bnes --dof 2 -o $(RESULTS)/chain.toml
	$(BIN)/linkwise simulate $(RESULTS)/chain.toml --duration 6 --rate 1000 --release v:m1=1.0 --noise 30 --seed 1 -o $(RESULTS)/record.csv
	$(BIN)/linkwise identify $(RESULTS)/record.csv $(RESULTS)/unknown.toml --truth $(RESULTS)/chain.toml -o $(RESULTS)/answer

study: env  ## reproduce the paper in results/paper: half an hour on two processors; stopped, it goes on where it was
	$(BIN)/linkwise study paper -o $(STUDY)

test: env  ## run all tests but those that take long
	$(TESTING) $(BIN)/python $(PYTEST) -m 'not slow'

test-slow: env  ## run the tests that take long
	$(TESTING) $(BIN)/python $(PYTEST) -m slow

test-all: env  ## run both kinds at once, collected once
	$(TESTING) $(BIN)/python $(PYTEST)

coverage: env  ## run all tests and measure the lines that they run; fail below the share in pyproject.toml
	$(TESTING) $(BIN)/python $(PYTEST) --cov

# Products of matrices differ in their last digits from one processor to another, and on one machine all tests meet the same.
# These judge fits whose laws are wrong, or nearly determine nothing, where searches and factors hang on rounding most; the
# others take half an hour and follow in `make matrix`.
NUMERICAL := tests/sindy tests/likelihood/shooting $(patsubst %,tests/likelihood/test_%.py,causes missing_terms score_tests) \
	$(addprefix tests/likelihood/test_,explained.py::test_a_coefficient_that_drifts_is_told_as_well \
	$(addprefix optima.py::test_,a_peak_among_others_is_not_trusted a_valley_that_bends_is_told \
	motion_that_neighbours_force_on_a_link_does_not_tell_its_frequency \
	a_motion_that_tells_no_well_is_not_trusted_and_names_what_it_does_not_tell))
kernels: env  ## run numerical tests with another kernel of OpenBLAS than this processor takes: other last digits, same answers
	$(TESTING) $(BIN)/python .ci/kernels.py $(BIN)/python $(PYTEST) $(NUMERICAL)

matrix: env  ## run all tests on every installed Python from 3.11, with the lowest dependencies, another BLAS kernel and two threads
	$(TESTING) $(BIN)/python .ci/matrix.py $(PYTEST)

INPUTS ?= 10000
fuzz: env  ## throw damaged and hostile inputs at every reader and command: 10 000, or INPUTS=20000
	PYTHONPATH=tests $(BIN)/python -m fuzz --inputs $(INPUTS)

BENCH ?= *
benchmark: env  ## measure speed and accuracy against the figures that they must reach: all, or BENCH='house peers'
	$(BIN)/python -m pytest -q -s $(foreach name,$(BENCH),benchmarks/bench_$(name).py)

CASES ?=
corpus: env  ## compare some 440 answers with stored ones: all, QUICK=1, or CASES='chain/*'; UPDATE=1 stores them again
	PYTHONPATH=tests $(TESTING) $(BIN)/python benchmarks/corpus.py $(foreach case,$(CASES),'$(case)') $(if $(QUICK),--quick) $(if $(UPDATE),--update)

check: env  ## lint, check the format and the types of the package and its tests
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

docs: $(VENV)/.docs  ## build the documentation in docs/site, with warnings as errors
	$(TESTING) $(BIN)/sphinx-build -q -E -W --keep-going -j auto -b html -d docs/site/.doctrees docs docs/site
	$(BIN)/python docs/check_site.py docs/site
	$(TESTING) $(BIN)/python -m pytest -q tests/docs

$(VENV)/.docs: $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check -e '.[docs]'
	@touch $@

clean:  ## remove the environment and what was built or written
	rm -rf $(VENV) .matrix .coverage results docs/site docs/api docs/gallery docs/generated .pytest_cache .mypy_cache .ruff_cache .hypothesis
