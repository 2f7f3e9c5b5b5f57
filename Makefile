# kilnflight: `make` runs every notebook and renders it; `make help` lists the rest.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
.DEFAULT_GOAL := all
#: settings, for example make quick PARAMETERS="seed=3 40.draws=20":
#:   PARAMETERS="name=value NN.name=value" for all notebooks, for notebook NN only
#:   JOBS=3                                notebooks side by side (4 GB each; make full: 6 GB),
#:                                         and processes of notebooks 50 and 56 in make full
#:   RECORDING=path                        film, folder, array ... for make film
#:   PYTHON=python3.11                     what .venv is made with
#:   KILNFLIGHT_EXTERNAL=folder            the authors' data, instead of data/external
#:   KILNFLIGHT_RECORDINGS=folder          belt recordings, instead of the authors'
#:   KILNFLIGHT_FIGURES=folder             instead of figures/ (full) or build/SCALE/figures
SCALE ?= standard
PARAMETERS ?=
# Notebooks often wait for a kernel: one more than cores, but not where each fills the memory.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n < 4 ? n + $(if $(filter full,$(SCALE) $(MAKECMDGOALS)),0,1) : 4)))
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin/python
OUT := build/$(SCALE)
MAKEFLAGS += --no-print-directory $(if $(filter 0,$(MAKELEVEL)),-j$(JOBS))
export KILNFLIGHT_EXTERNAL KILNFLIGHT_RECORDINGS KILNFLIGHT_FIGURES
unexport PYTHONDONTWRITEBYTECODE# Python starts some hundred times: its bytecode is kept
# Freed memory is kept for the next frame; processes share the work, threads would only wait.
export MALLOC_MMAP_THRESHOLD_ ?= 1073741824
export MALLOC_TRIM_THRESHOLD_ ?= 4294967296
export OPENBLAS_NUM_THREADS ?= 1
export OPENCV_FOR_THREADS_NUM ?= 1
export NUMPY_MADVISE_HUGEPAGE ?= 0# clearing huge pages takes a twentieth of a frame's time

NOTEBOOKS := $(patsubst notebooks/%.py,$(OUT)/%.ipynb,$(sort $(wildcard notebooks/[0-9][0-9]_*.py)))
SUMMARY := $(filter %/00_claims.ipynb %/01_choices.ipynb,$(NOTEBOOKS))# collect what the others conclude
# 23 compiles what those of the kiln share, once for all of them; beside it run those of the belt.
COMPILES := $(filter-out $(MAKECMDGOALS),$(filter $(OUT)/23_%,$(NOTEBOOKS)))
COMPILED := $(filter-out $(OUT)/23_% $(OUT)/4% $(MAKECMDGOALS),$(NOTEBOOKS))
# The longest begin.
LONGEST := $(foreach number,23 45 43 40 50 24 32 10 22 20 31 60,$(filter $(OUT)/$(number)_%,$(NOTEBOOKS)))
# 50 detects in all campaigns, and the others of 50 to 59 take its tables. In full it has JOBS
# processes, as 56, of 3 GB each, and nothing runs beside it.
CAMPAIGNS := $(filter-out $(MAKECMDGOALS),$(filter $(OUT)/50_%,$(NOTEBOOKS)))
LATER := $(filter-out $(CAMPAIGNS) $(MAKECMDGOALS),$(filter $(OUT)/5%,$(NOTEBOOKS)))
QUEUE := $(LONGEST) $(filter-out $(LONGEST) $(SUMMARY),$(NOTEBOOKS))
SOURCES := $(filter-out %/notebooks.py,$(shell find analysis/kilnflight data/reference -name '*.py' -o -name '*.json' -o -name '*.csv'))
# Scales never mix: figures/ holds what make full made.
FIGURES := $(or $(KILNFLIGHT_FIGURES),$(if $(filter full,$(SCALE)),,$(CURDIR)/$(OUT)/figures))
$(NOTEBOOKS) site/index.html: export KILNFLIGHT_FIGURES := $(FIGURES)
film: export KILNFLIGHT_FIGURES := $(CURDIR)/build/film/figures

.PHONY: all quick standard full film setup data test faults check bench dist clean help FORCE
all: site/index.html
	@echo "kilnflight: up to date at scale $(SCALE); read site/index.html; figures are in $(or $(FIGURES),figures/)"
quick standard full: ## little input; less input (the default); all of it, into figures/, and the README
	@$(MAKE) SCALE=$@ all
	@$(if $(filter full,$@),$(RUN) docs/generate.py --readme)
film: $(VENV)/installed ## the notebook of one film of yours, into build/film: make film RECORDING=path
	@$(RUN) -m kilnflight.publication.notebooks notebooks/60_own_film.py --build build/film -p scale=full -p "60.recording=$(RECORDING)"
	@$(RUN) docs/generate.py build/film build/film/site
setup: $(VENV)/installed ## create .venv and install the locked packages
data: $(VENV)/installed ## fetch the authors' public data (optional; needs a network)
	@$(RUN) -m kilnflight.publication.data && mkdir -p build && touch build/external.txt
LAST := tests/test_notebooks.py# waits for the smoke run of the first
FIRST := tests/test_site_pages.py tests/test_makefile.py
test: $(VENV)/installed ## run the tests, file by file in JOBS processes
	@$(RUN) -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "not published" $(FIRST) $(filter-out $(FIRST) $(LAST),$(wildcard tests/test_*.py tests/*/test_*.py)) $(LAST) analysis
faults: $(VENV)/installed ## try some 10,000 faults of input, and count what becomes of them
	@PYTHONPATH=. $(RUN) tests/faults/test_faults.py
check: $(VENV)/installed ## lint, format, types, architecture, sizes, and that figures/ and README belong together
	@$(RUN) -m ruff check . && $(RUN) -m ruff format --check . && $(RUN) -m mypy && $(VENV)/bin/lint-imports
	@$(RUN) -m pytest -q -m published $$(grep -rl --include='test_*.py' mark.published tests)
bench: $(VENV)/installed ## measure speed against peers, and growth, into figures/ (20 minutes)
	@$(RUN) benchmarks/run.py
dist: $(VENV)/installed ## build wheel and source archive, into dist/
	@rm -rf dist build/lib && $(RUN) -c "from setuptools import build_meta as b; b.build_sdist('dist'), b.build_wheel('dist')" > /dev/null
clean: ## remove what make has made, but neither figures/ nor the fetched data
	rm -rf build dist site data/derived $(VENV) .*_cache .hypothesis analysis/*.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +
help: ## list the targets and settings
	@sed -nE 's/^([a-z][a-z ]*):[^#=]*## (.*)/  make \1\t\2/p; s/^#: ?//p' Makefile | expand -t 28

# Newer than the notebook where it has to run again: for other settings, or a lost figure.
$(OUT)/%.settings: FORCE
	@mkdir -p $(@D); n=$*; s="$(KILNFLIGHT_EXTERNAL) $(KILNFLIGHT_RECORDINGS) $(KILNFLIGHT_FIGURES) $(PARAMETERS)"; \
	  s=$$(printf '%s\n' $$s | grep -vE "^([^$${n:0:1}]|.[^$${n:1:1}]).\..*=" || true); \
	  [ "$$s" = "$$(cat $@ 2>/dev/null || echo none)" ] && cat $(OUT)/$*.saved 2>/dev/null | xargs -r -d '\n' ls &> /dev/null || echo "$$s" > $@
$(NOTEBOOKS): $(OUT)/%.ipynb: notebooks/%.py $(OUT)/%.settings $(SOURCES) build/external.txt | $(VENV)/installed
	@touch $(OUT)/$*.saved; $(RUN) -m kilnflight.publication.notebooks $< --build $(OUT) $(addprefix -p ,scale=$(SCALE) $(if $(filter full/50_% full/56_%,$(SCALE)/$*),$(firstword $(subst _, ,$*)).jobs=$(JOBS)) $(PARAMETERS))
$(SUMMARY): $(QUEUE)
$(COMPILED): | $(COMPILES)
$(LATER): | $(CAMPAIGNS)
$(if $(filter full,$(SCALE)),$(CAMPAIGNS): | $(filter-out $(CAMPAIGNS) $(LATER) $(SUMMARY),$(NOTEBOOKS)))
build/scale: FORCE
	@mkdir -p build; [ "$(SCALE)" = "$$(cat $@ 2>/dev/null)" ] || echo $(SCALE) > $@
site/index.html: $(QUEUE) $(SUMMARY) build/scale $(shell find docs -type f)
	@echo "site: rendering $(words $(NOTEBOOKS)) notebooks"; $(RUN) docs/generate.py $(OUT) site
# The authors' data if there is a network; a second make does not ask again (make data does).
build/external.txt: analysis/kilnflight/publication/data.py | $(VENV)/installed
	@mkdir -p build; $(RUN) -m kilnflight.publication.data --optional && touch $@

fail = { echo "setup: $(1)" >&2; exit 1; }
install = $(RUN) -m pip install --quiet --disable-pip-version-check $(1) >> build/pip.log 2>&1
pip = $(call install,$(1)) || $(call fail,pip failed: $$(grep -m1 ERROR build/pip.log || tail -1 build/pip.log) (all of it: build/pip.log))
locked := --require-hashes -r requirements.lock
uv = $(VENV)/bin/uv pip install --quiet --python $(RUN) $(1) >> build/pip.log 2>&1
$(VENV)/installed: requirements.lock pyproject.toml
	@echo "setup: creating $(VENV) with $(PYTHON) and the locked packages (a minute or two)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || $(call fail,$(PYTHON) is older than 3.11; name a newer one: make PYTHON=python3.11)
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || $(call fail,$(PYTHON) has no venv; on Debian: apt-get install python3-venv)
	@$(PYTHON) -m venv $(VENV) && mkdir -p build && : > build/pip.log
# uv takes a third of pip's time; where it cannot do it (a mirror that only pip knows), pip does.
	@sed -n '/^uv==/,/[^\]$$/p' requirements.lock > build/uv.lock
	@{ $(call install,--require-hashes -r build/uv.lock) && $(call uv,$(locked)); } || { echo "setup: not by uv (build/pip.log); pip takes some two minutes more"; $(call pip,$(locked)); }
	@$(call pip,--no-deps --no-build-isolation -e .)
	@touch $@
