# kilnflight: `make` runs every notebook and renders it; `make help` lists the rest.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
.DEFAULT_GOAL := all
#: settings, for example make SCALE=full PARAMETERS="seed=3 40.draws=20":
#:   SCALE=quick|standard|full             how much input the notebooks take
#:   PARAMETERS="name=value NN.name=value" for all notebooks, for notebook NN only
#:   JOBS=2                                notebooks side by side (up to 3 GB each)
#:   PYTHON=python3.11                     what .venv is made with
#:   KILNFLIGHT_EXTERNAL=folder            the authors' data, instead of data/external
#:   KILNFLIGHT_RECORDINGS=folder          belt recordings, instead of the authors'
#:   KILNFLIGHT_FIGURES=folder             where figures go, instead of figures/ (full) or build/SCALE
SCALE ?= standard
PARAMETERS ?=
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n < 4 ? n : 4)))
PYTHON ?= python3
VENV ?= .venv
RUN := $(VENV)/bin/python
MAKEFLAGS += --no-print-directory $(if $(filter 0,$(MAKELEVEL)),-j$(JOBS))
export KILNFLIGHT_EXTERNAL KILNFLIGHT_RECORDINGS KILNFLIGHT_FIGURES
# Freed memory is kept for the next frame; processes share the work, threads would only wait.
export MALLOC_MMAP_THRESHOLD_ ?= 1073741824
export MALLOC_TRIM_THRESHOLD_ ?= 4294967296
export OPENBLAS_NUM_THREADS ?= 1

STEMS := $(basename $(notdir $(sort $(wildcard notebooks/[0-9][0-9]_*.py))))
EXECUTED := $(STEMS:%=build/%.ipynb)
SUMMARY := build/00_claims.ipynb
number = $(firstword $(subst _, ,$(1)))
SOURCES := $(filter-out %/notebooks.py $(wildcard analysis/kilnflight/project/site/*) %/README.md,$(sort $(shell find analysis/kilnflight data/reference -name '*.py' -o -name '*.json' -o -name '*.md' -o -name '*.txt' -o -name '*.csv')))
# What others wait for starts early, beside what does not wait: 30 to 34 share the detections
# that 31 makes, 50 to 56 and 14 those that 50 makes; 32 to 34 read some of these, too. The first
# that share compiled code start beside those of the belt: together they would compile it twice.
# Of the rest 56 and 54 take longest.
QUEUE := $(foreach start,10 40 41 20 42 47 46 22 43 11 24 30 31 57 12 13 21 23 25 50 32 33 14 56 54,$(filter build/$(start)_%,$(EXECUTED)))
QUEUE += $(filter-out $(QUEUE) $(SUMMARY),$(EXECUTED))

# Scales never mix: what is cited comes from make full alone. Only notebooks and the site are
# sent elsewhere: a make that this one starts decides anew, checks and tests look at figures/.
ifeq ($(or $(filter full,$(SCALE)),$(KILNFLIGHT_FIGURES)),)
$(EXECUTED) site/index.html: export KILNFLIGHT_FIGURES := $(CURDIR)/build/$(SCALE)
endif

# A notebook runs again when its settings change (scale, its own parameters, folders), which
# are kept in files, or when one of its figures has gone missing.
OTHER := quick full report setup data test check bench clean help
keep = $(if $(findstring |$(strip $(2))|,|$(file <$(1))|),,$(file >$(1),$(strip $(2))))
numbers := $(foreach stem,$(STEMS),$(call number,$(stem)))
others = $(addsuffix .%,$(filter-out $(call number,$(1)),$(numbers)))
ifneq ($(filter-out $(OTHER),$(or $(MAKECMDGOALS),all)),)
$(shell mkdir -p build; for list in build/*.saved; do [ -e "$$list" ] || continue; while IFS= read -r file; do [ -e "$$file" ] || rm -f "$${list%.saved}.ipynb"; done < "$$list"; done)
$(foreach stem,$(STEMS),$(call keep,build/$(stem).settings,$(SCALE) $(filter-out $(call others,$(stem)),$(PARAMETERS))))
$(call keep,build/folders.settings,folders: $(KILNFLIGHT_EXTERNAL) $(KILNFLIGHT_RECORDINGS) $(KILNFLIGHT_FIGURES))
endif

.PHONY: all $(OTHER)
quick_note := a smoke run, its figures are in build/quick; figures/ is as it was
standard_note := a reduced run, its figures are in build/standard; cite from figures/, which is as it was
full_note := cite from figures/
all: site/index.html ## run every notebook at standard scale and render the site (the default)
	@echo "kilnflight: up to date at scale $(SCALE); read site/index.html; $($(SCALE)_note)"
quick: ## a smoke run: every notebook, little input; its figures go to build/quick
	@$(MAKE) SCALE=quick all
full: ## the same at the scale of the publications; what figures/ and the README hold
	@$(MAKE) SCALE=full all
	@$(RUN) -m kilnflight.project.site --readme
report: $(VENV)/installed ## print what figures/ holds as a PDF, build/report.pdf
	@$(RUN) -m kilnflight.project.site.report
setup: $(VENV)/installed ## create .venv and install the locked packages
data: $(VENV)/installed ## fetch the authors' public data (optional; needs a network)
	@$(RUN) -m kilnflight.project.data
	@mkdir -p build && touch build/folders.settings
# Files go to the processes one by one. Those that take longest come first; what shares the smoke
# run of the first comes last, and need not wait for it.
FIRST := $(addprefix tests/,test_site_pages.py test_makefile.py test_kiln.py test_interrupted.py)
LAST := tests/test_notebooks.py
test: $(VENV)/installed ## run the tests, file by file in JOBS processes
	@$(RUN) -m pytest -n $(JOBS) --dist loadfile --no-loadscope-reorder -m "not published" $(FIRST) $(filter-out $(FIRST) $(LAST),$(wildcard tests/test_*.py tests/*/test_*.py)) $(LAST) analysis
check: $(VENV)/installed ## lint, format, types, architecture, and that figures/ and README belong together
	@$(RUN) -m ruff check . && $(RUN) -m ruff format --check . && $(RUN) -m mypy
	@$(VENV)/bin/lint-imports
	@$(RUN) -m pytest -q -m published $$(grep -rl --include='test_*.py' mark.published tests)
bench: $(VENV)/installed ## measure speed against peers, into figures/benchmarks.csv
	@$(RUN) benchmarks/run.py
clean: ## remove what make has made, but neither figures/ nor the fetched data
	rm -rf build site data/derived $(VENV) .*_cache .hypothesis analysis/*.egg-info
	find . -name __pycache__ -prune -exec rm -rf {} +
help: ## list the targets and settings
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/  make \1\t\2/p; s/^#: ?//p' Makefile | expand -t 16

fail = { echo "setup: $(1)" >&2; exit 1; }
install = $(RUN) -m pip install --quiet --disable-pip-version-check $(1) >> build/pip.log 2>&1
pip = $(call install,$(1)) || $(call fail,pip failed: $$(grep -m1 ERROR build/pip.log || tail -1 build/pip.log) (all of it: build/pip.log))
locked := --require-hashes -r requirements.lock
uv = $(VENV)/bin/uv pip install --quiet --compile-bytecode --python $(RUN) $(1) >> build/pip.log 2>&1
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
# The authors' data if there is a network; a second make does not ask again (make data does).
build/external.txt: build/folders.settings analysis/kilnflight/project/data.py | $(VENV)/installed
	@$(RUN) -m kilnflight.project.data --optional
	@touch $@
$(EXECUTED): build/%.ipynb: notebooks/%.py build/%.settings $(SOURCES) build/external.txt | $(VENV)/installed
	@$(RUN) -m kilnflight.project.notebooks $< $(addprefix -p ,scale=$(SCALE) $(PARAMETERS))
$(SUMMARY): $(QUEUE) # it collects what the others conclude
site/index.html: $(QUEUE) $(SUMMARY) $(wildcard analysis/kilnflight/project/site/*)
	@$(RUN) -m kilnflight.project.site $(EXECUTED)
