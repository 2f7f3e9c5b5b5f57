# kilnflight: `make` runs every notebook and renders it; `make help` lists the rest.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
.DEFAULT_GOAL := all
#: settings, for example make quick PARAMETERS="seed=3 40.draws=20":
#:   PARAMETERS="name=value NN.name=value" for all notebooks, for notebook NN only
#:   ONLY="52 53"                          only these notebooks, for make notebooks
#:   JOBS=3                                notebooks side by side (4 GB each; make full: 6 GB),
#:                                         and processes of notebooks 50 and 56 in make full
#:   RECORDING=path                        film, folder, array ... for make film
#:   FIGURE=fig-5-19                       id of a figure or table, or its beginning, for make cite
#:   PYTHON=python3.11                     what .venv is made with
#:   KILNFLIGHT_EXTERNAL=folder            the authors' data, instead of data/external
#:   KILNFLIGHT_RECORDINGS=folder          belt recordings, instead of the authors'
#:   KILNFLIGHT_LABELLED=manifest          labelled frames of the kiln, for notebook 12
#:   PARTS=all                             also the 5 GB beside them, for make data
#:   KILNFLIGHT_FIGURES=folder             instead of figures/ (full) or build/SCALE/figures
SCALE ?= standard
PARAMETERS ?=
ONLY ?=
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin/python
# Notebooks often wait for a kernel: one more than cores, but not where each fills the memory.
CORES := $(shell nproc 2>/dev/null || echo 1)
JOBS ?= $(shell n=$$(($(CORES) + $(if $(filter full seeds,$(SCALE) $(MAKECMDGOALS)),0,1))); echo $$((n < 4 ? n : 4)))
# Scales never mix: figures/ holds what make full made.
FIGURES := $(or $(KILNFLIGHT_FIGURES),$(if $(filter full,$(SCALE)),,$(CURDIR)/build/$(SCALE)/figures))
MAKEFLAGS += --no-print-directory
export KILNFLIGHT_EXTERNAL KILNFLIGHT_RECORDINGS KILNFLIGHT_LABELLED KILNFLIGHT_FIGURES
unexport PYTHONDONTWRITEBYTECODE# Python starts some hundred times: its bytecode is kept
# Freed memory is kept for the next frame; processes share the work, threads would only wait.
export MALLOC_MMAP_THRESHOLD_ ?= 1073741824
export MALLOC_TRIM_THRESHOLD_ ?= 4294967296
export OPENBLAS_NUM_THREADS ?= 1
export OPENCV_FOR_THREADS_NUM ?= 1
export NUMPY_MADVISE_HUGEPAGE ?= 0# clearing huge pages takes a twentieth of a frame's time
.PHONY: all quick standard full notebooks film setup data test faults check cite bench seeds dist clean help

all: notebooks
	@{ [ site/index.html -nt build/$(SCALE)/ran ] && [ "$$(cat build/site 2> /dev/null)" = $(SCALE) ] && \
	  [ -z "$$(find docs $(wildcard figures/index.json) -newer site/index.html)" ]; } || { \
	  $(RUN) tools/gallery.py build/gallery; echo "site: rendering the notebooks"; KILNFLIGHT_FIGURES=$(FIGURES) $(RUN) docs/generate.py build/$(SCALE) site; echo $(SCALE) > build/site; }
	@echo "kilnflight: up to date at scale $(SCALE); read site/index.html; figures are in $(or $(FIGURES),figures/)"
quick standard full: ## little input; less input (the default); all of it, into figures/, and the README
	@$(MAKE) SCALE=$@ all
	@$(if $(filter full,$@),$(RUN) docs/generate.py --readme)
notebooks: $(VENV)/installed build/external.txt ## the notebooks that are out of date, without pages
	@KILNFLIGHT_FIGURES=$(FIGURES) $(RUN) tools/schedule.py $(SCALE) --jobs $(JOBS) --only $(ONLY) --parameters $(PARAMETERS)
film: $(VENV)/installed ## the notebook of one film of yours, into build/film: make film RECORDING=path
	@export KILNFLIGHT_FIGURES=$(CURDIR)/build/film/figures; \
	  $(RUN) tools/execute.py notebooks/60_own_film.py --build build/film -p scale=full -p "60.recording=$(RECORDING)"; \
	  $(RUN) docs/generate.py build/film build/film/site
setup: $(VENV)/installed ## create .venv and install the locked packages
data: $(VENV)/installed ## fetch the authors' public data (optional; needs a network)
	@$(RUN) tools/fetch.py $(if $(filter all,$(PARTS)),--all) && mkdir -p build && touch build/external.txt
test: $(VENV)/installed ## run the tests, file by file in JOBS processes
	@$(RUN) -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "not published" tests analysis
faults: $(VENV)/installed ## try some 34,000 faults of input and of runs (an hour), and count what becomes of them
	@PYTHONPATH=. $(RUN) tests/faults/test_faults.py
check: $(VENV)/installed ## lint, format, types, architecture, sizes, and that figures/ and README belong together
	@$(RUN) -m ruff check . && $(RUN) -m ruff format --check . && $(RUN) -m mypy && $(VENV)/bin/lint-imports
	@$(RUN) -m pytest -q -m published tests
cite: $(VENV)/installed ## how to cite a figure or table of figures/: make cite FIGURE=fig-5-19
	@$(RUN) docs/generate.py --cite "$(FIGURE)"
bench: $(VENV)/installed ## measure speed against peers, and growth, into figures/ (20 minutes)
	@$(RUN) benchmarks/run.py
seeds: $(VENV)/installed ## headline numbers of the kiln with seeds 1 and 2, into figures/ (two to four hours)
	@for seed in 1 2; do echo "seed $$seed"; \
	  KILNFLIGHT_FIGURES=$(CURDIR)/build/seed-$$seed/figures $(RUN) tools/schedule.py full --build build/seed-$$seed \
	    --jobs $(JOBS) --only 20 24 32 50 52 53 54 00 --parameters seed=$$seed; done
	@$(RUN) tools/seeds.py
dist: $(VENV)/installed ## build wheel and source archive, into dist/
	@rm -rf dist build/lib && $(RUN) -c "from setuptools import build_meta as b; b.build_sdist('dist'), b.build_wheel('dist')" > /dev/null
clean: ## remove what make has made, but neither figures/ nor the fetched data
	rm -rf build dist site data/derived $(VENV) .*_cache .hypothesis analysis/*.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +
help: ## list the targets and settings
	@sed -nE 's/^([a-z][a-z ]*):[^#=]*## (.*)/  make \1\t\2/p; s/^#: ?//p' Makefile | expand -t 28

# The authors' data if there is a network; a second make does not ask again (make data does).
build/external.txt: tools/fetch.py | $(VENV)/installed
	@mkdir -p build; $(RUN) tools/fetch.py --optional && touch $@
$(VENV)/installed: requirements.lock pyproject.toml
	@PYTHON=$(PYTHON) VENV=$(VENV) bash .ci/setup
	@touch $@
