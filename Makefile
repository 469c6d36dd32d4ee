# The README's two lines as targets; the virtual environment is made once.
PYTHON ?= python3
VENV ?= .venv

.PHONY: demo test figures figures-short clean

demo: $(VENV)/installed
	$(VENV)/bin/up-samp demo

test: $(VENV)/installed-with-tests
	$(VENV)/bin/python scripts/check.py

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
