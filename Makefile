VENV ?= .venv
ACTIVATE = . $(VENV)/bin/activate

.DEFAULT_GOAL := help
.PHONY: help setup test patch3d lint clean

help: ## list the targets
	@sed -n 's/^\([a-z0-9]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

setup: ## install what is missing from Debian and make .venv; quick when all is there
	@.ci/setup $(VENV)

test: setup ## run the tests; ARGS="-k word" is passed on to pytest
	$(ACTIVATE) && pytest $(ARGS)

patch3d: setup ## run the 3D patch test on two ranks
	$(ACTIVATE) && mpirun -n 2 python demos/patch3d.py

lint: setup ## check style and format; installs ruff from PyPI into .venv
	@test -x $(VENV)/bin/ruff || $(VENV)/bin/pip install -q -c $(VENV)/constraints.txt \
		--no-build-isolation -e '.[dev]'
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .

clean: ## remove .venv and what builds and tests left
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
