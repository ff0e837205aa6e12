VENV ?= .venv
WORKERS ?= 2
ACTIVATE = . $(VENV)/bin/activate
PARALLEL = -n $(WORKERS) --dist loadgroup

.DEFAULT_GOAL := help
.PHONY: help setup tools test quick long figures patch3d coverage check lint types docs gallery clean

help: ## list the targets
	@sed -n 's/^\([a-z0-9]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

setup: ## install what is missing from Debian and make .venv; quick when all is there
	@.ci/setup $(VENV)

test: setup ## run the tests, WORKERS at once; ARGS="-k word" is passed on to pytest
	$(ACTIVATE) && pytest $(PARALLEL) $(ARGS)

quick: setup ## run those that take no more than a moment, on one rank
	$(ACTIVATE) && pytest $(PARALLEL) -m "quick and not mpi and not long" $(ARGS)

long: setup ## run what `make test` has only a sample of: campaigns, products, large meshes; PART=2/10
	$(ACTIVATE) && pytest $(PARALLEL) -m long $(ARGS)

figures: setup ## make README's table of results from the demos; ARGS=--check: is it true?
	$(ACTIVATE) && python .ci/figures.py $(ARGS)

patch3d: setup ## run the 3D patch test on two ranks
	$(ACTIVATE) && mpirun -n 2 python demos/patch3d.py

coverage: tools ## run the tests, their demos and ranks, and report what they do not reach
	@mkdir -p build/coverage
	$(ACTIVATE) && COVERAGE_FILE=$(CURDIR)/build/coverage/data pytest $(PARALLEL) --cov --cov-report=term $(ARGS)

check: lint types docs ## all checks that run no test

lint: tools ## check style and format
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

types: tools ## check types
	$(VENV)/bin/mypy

docs: tools ## build the pages, the gallery of demos and all public names in build/docs
	$(ACTIVATE) && python .ci/docs.py build/docs && python .ci/gallery.py pages build/docs

gallery: tools ## run the demos, keep their pictures and numbers, and build the pages; DEMOS="slope", DEMOS=0/3
	$(ACTIVATE) && python .ci/gallery.py run $(DEMOS) && python .ci/gallery.py pages build/docs

tools: setup # from PyPI into .venv; a new .venv has none of them
	@test -e $(VENV)/tools || { $(VENV)/bin/pip install -q --disable-pip-version-check \
		-c $(VENV)/constraints.txt --no-build-isolation -e '.[dev]' && touch $(VENV)/tools; }

clean: ## remove .venv and what builds and tests left
	rm -rf $(VENV) build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
