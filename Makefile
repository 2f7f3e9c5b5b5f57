# kilnflight: `make` runs every notebook and renders it; `make help` lists the rest.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
.SUFFIXES:
.DEFAULT_GOAL := all
MAKEFLAGS += --no-print-directory
# Notebooks side by side: one per core, four at most (each takes up to 3 GB); make JOBS=1 for
# one after the other.
JOBS ?= $(shell n=$$(nproc 2>/dev/null || echo 1); echo $$((n < 4 ? n : 4)))
ifeq ($(MAKELEVEL),0)
MAKEFLAGS += -j$(JOBS)
endif

# What a user may set, for example: make SCALE=full PARAMETERS="seed=3 40.draws=20"
SCALE ?= standard
PARAMETERS ?=
PYTHON ?= python3
VENV ?= .venv
export KILNFLIGHT_EXTERNAL KILNFLIGHT_RECORDINGS KILNFLIGHT_FIGURES
ifeq ($(SCALE)$(KILNFLIGHT_FIGURES),quick)
KILNFLIGHT_FIGURES := $(CURDIR)/build/quick
endif

RUN := $(VENV)/bin/python
STEMS := $(basename $(notdir $(sort $(wildcard notebooks/[0-9][0-9]_*.py))))
FIRST := 00_claims
EXECUTED := $(STEMS:%=build/%.ipynb)
NUMBERS := $(foreach stem,$(STEMS),$(firstword $(subst _, ,$(stem))))
LIBRARY := $(filter-out %/project/notebooks.py %/project/site.py,$(shell find analysis/kilnflight -name '*.py' -o -name '*.json' -o -name '*.txt' | sort))
FACTS := $(shell find data/reference -name '*.csv' | sort)

# Freed memory is kept for the next frame: to be given it anew costs more than to reuse it.
export MALLOC_MMAP_THRESHOLD_ ?= 1073741824
export MALLOC_TRIM_THRESHOLD_ ?= 4294967296

# Work is shared among processes; threads of linear algebra would only wait for each other.
export OPENBLAS_NUM_THREADS ?= 1

# In which order notebooks start: what others wait for early, and beside what does not wait.
# 30 to 34 share the detections that 31 makes, 50 to 56 those that 50 makes. The first of those
# that share compiled code start beside those of the belt: together they would compile it twice.
starts = $(foreach number,$(1),$(filter build/$(number)%,$(EXECUTED)))
QUEUE := $(call starts,0 10 40 41 20 42 22 43 11 24 30 31 12 13 21 23 25 50 32 33)
QUEUE += $(filter-out $(QUEUE),$(EXECUTED))

# Settings are kept in files that change only when the setting does, so that make knows
# what to run again: one for each notebook's parameters, one for the folders that the
# environment names. Targets that run no notebook leave them alone.
settings = SCALE=$(SCALE) $(foreach item,$(PARAMETERS),$(if $(filter $(addsuffix .%,$(NUMBERS)),$(item)),$(filter $(firstword $(subst _, ,$(1))).%,$(item)),$(item)))
keep = $(shell mkdir -p build; printf '%s\n' '$(subst ','\'',$(strip $(2)))' | cmp -s - $(1) || printf '%s\n' '$(subst ','\'',$(strip $(2)))' > $(1))
OTHER := quick full setup data test check bench clean help
ifneq ($(filter-out $(OTHER),$(or $(MAKECMDGOALS),all)),)
$(foreach stem,$(STEMS),$(call keep,build/$(stem).settings,$(call settings,$(stem))))
$(call keep,build/folders.settings,$(KILNFLIGHT_EXTERNAL) $(KILNFLIGHT_RECORDINGS) $(KILNFLIGHT_FIGURES))
# A notebook one of whose figures has gone missing is to run again.
$(shell for list in build/*.saved; do [ -e "$$list" ] || continue; while IFS= read -r file; do [ -e "$$file" ] || rm -f "$${list%.saved}.ipynb"; done < "$$list"; done)
endif

.PHONY: all $(OTHER)

all: site/index.html ## run every notebook at standard scale and render the site (the default)
	@echo "kilnflight: up to date at scale $(SCALE); read site/index.html"
	@case $(SCALE) in \
	  full) echo "kilnflight: cite from figures/" ;; \
	  quick) echo "kilnflight: a smoke run; figures/ is as it was" ;; \
	  *) echo "kilnflight: figures/ holds this run now; git checkout figures gives back those of make full, to be cited" ;; \
	esac

quick: ## a smoke run: every notebook, little input; its figures go to build/quick
	@$(MAKE) SCALE=quick all

full: ## the same at the scale of the publications; what figures/ and the README hold
	@$(MAKE) SCALE=full all
	@$(RUN) -m kilnflight.project.site --readme

setup: $(VENV)/installed ## create .venv and install the locked packages

data: $(VENV)/installed ## fetch the authors' public data (optional; needs a network)
	@$(RUN) -m kilnflight.project.data
	@touch build/folders.settings

test: $(VENV)/installed ## run the tests
	@$(RUN) -m pytest -m "not published"

check: $(VENV)/installed ## lint, format, types, architecture, and that figures/ and README belong together
	@$(RUN) -m ruff check .
	@$(RUN) -m ruff format --check .
	@$(RUN) -m mypy
	@$(VENV)/bin/lint-imports
	@$(RUN) -m pytest -q -m published

bench: $(VENV)/installed ## measure speed against peers, into figures/benchmarks.csv
	@$(RUN) benchmarks/run.py

clean: ## remove what make has made, but neither figures/ nor the fetched data
	rm -rf build site data/derived $(VENV) .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -rf {} +
	rm -rf analysis/*.egg-info

help: ## list the targets
	@echo "targets:"
	@sed -nE 's/^([a-z]+):[^#]*## (.*)/  make \1\t\2/p' Makefile | expand -t 16
	@echo "settings: SCALE=quick|standard|full, PARAMETERS=\"name=value NN.name=value\","
	@echo "          KILNFLIGHT_EXTERNAL=folder with the authors' data, PYTHON=python3.11,"
	@echo "          KILNFLIGHT_RECORDINGS=folder with the authors' belt recordings,"
	@echo "          KILNFLIGHT_FIGURES=folder to write figures to instead of figures/"

$(VENV)/installed: requirements.lock pyproject.toml
	@echo "setup: creating $(VENV) with $(PYTHON)"
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "setup: $(PYTHON) is older than 3.11; name a newer one: make PYTHON=python3.11" >&2; exit 1; }
	@$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || { echo "setup: $(PYTHON) has no venv; on Debian: apt-get install python3-venv" >&2; exit 1; }
	@$(PYTHON) -m venv $(VENV)
	@echo "setup: installing the locked packages (a minute or two)"
	@mkdir -p build
	@$(RUN) -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock > build/pip.log 2>&1 || { echo "setup: pip failed: $$(grep -m1 ERROR build/pip.log || tail -1 build/pip.log) (all of it: build/pip.log)" >&2; exit 1; }
	@$(RUN) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e . >> build/pip.log 2>&1 || { echo "setup: pip failed on kilnflight itself; see build/pip.log" >&2; exit 1; }
	@touch $@

# The authors' data if there is a network; a second make does not ask again (make data does).
build/external.txt: build/folders.settings analysis/kilnflight/project/data.py | $(VENV)/installed
	@$(RUN) -m kilnflight.project.data --optional
	@touch $@

$(EXECUTED): build/%.ipynb: notebooks/%.py build/%.settings $(LIBRARY) $(FACTS) build/external.txt | $(VENV)/installed
	@$(RUN) -m kilnflight.project.notebooks $< $(addprefix -p ,scale=$(SCALE) $(PARAMETERS))

# The first notebook collects what the others conclude.
build/$(FIRST).ipynb: $(filter-out build/$(FIRST).ipynb,$(QUEUE))

site/index.html: $(EXECUTED) analysis/kilnflight/project/site.py
	@$(RUN) -m kilnflight.project.site $(EXECUTED)
