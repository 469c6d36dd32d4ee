# The README's two lines as targets, and parts of them; the virtual environment is made once.
PYTHON ?= python3
VENV ?= .venv
# a room of up_samp/, as in: make test ROOM=motion/fleet
ROOM ?=

.PHONY: demo test lint fast figures figures-short clean

demo: $(VENV)/installed
	$(VENV)/bin/up-samp demo

test: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/check.py $(if $(ROOM),room $(ROOM))

lint: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/check.py lint

fast: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/check.py fast

figures: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/figures.py --keep --docs

figures-short: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/figures.py --short

$(VENV)/installed: pyproject.toml setup.py
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -e .
	touch $@

$(VENV)/installed-with-tests: pyproject.toml setup.py
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -e '.[test]'
	touch $@ $(VENV)/installed

clean:
	rm -rf $(VENV) build *.egg-info demo-out
