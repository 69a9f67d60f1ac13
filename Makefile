# make demo   everything once, from a bare machine: install, render, train, export, denoise, evaluate
# make test   every test, the notebooks included
# make lint   style and types
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed

.PHONY: demo test fast lint acceptance clean

demo: $(INSTALLED)
	$(BIN)/nte render datasets/quickstart.yaml --out data/quickstart
	$(BIN)/nte train configs/quickstart.yaml resume=true --device cpu
	$(BIN)/nte export runs/quickstart --out demo/quickstart.onnx --force
	$(BIN)/nte denoise data/quickstart/test/rooms_000 --denoiser demo/quickstart.onnx --out demo/denoised --png --force
	$(BIN)/nte evaluate --clips data/quickstart/test --out demo/report --force \
		--denoisers noisy taa:clamp=none taa taa:clamp=clip oidn:quality=fast oidn demo/quickstart.onnx

test: $(INSTALLED)
	$(BIN)/pytest

fast: $(INSTALLED)
	$(BIN)/pytest -m "not slow"

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/mypy

# What the demo must have reached; run it after make demo.
acceptance: $(INSTALLED)
	$(BIN)/pytest -s tests/acceptance

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.version_info >= (3, 11) or sys.exit('nte needs Python 3.11 or newer, this is ' + sys.version.split()[0] + ': make PYTHON=python3.11 …')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[render,train,eval,import,cluster,compare,burst,dev]'
	@touch $@

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
