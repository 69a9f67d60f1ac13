# make demo   everything once, from a bare machine: install, render, train, export, denoise, evaluate
# make test   the tests of every change           make slow   those that render, train, start processes; the notebooks
# make lint   style and types
# make docs   the documentation as a site: site/index.html
# make coverage   the lines of nte/ that make test leaves out      make torture   long rounds of faults and bad input
# make viewer the script and style sheet of the viewer, after a change of its sources; needs Node 20 or newer
# make supply the lock file, an audit and a bill of materials; needs a network
# make compat the fast tests with the lowest and the newest versions of everything that is allowed; needs a network
# make paper  the published comparisons, with their data: a night or two       make bench   times, as ratios in one run
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed

.PHONY: demo test slow torture coverage lint docs viewer viewer-check viewer-fresh acceptance paper bench supply compat compat-lowest compat-newest \
	clean

demo: $(INSTALLED)
	$(BIN)/nte render datasets/quickstart.yaml --out data/quickstart
	$(BIN)/nte train configs/quickstart.yaml resume=true --device cpu
	$(BIN)/nte export runs/quickstart --out demo/quickstart.onnx --force
	$(BIN)/nte denoise data/quickstart/test/rooms_000 --denoiser demo/quickstart.onnx --out demo/denoised --png --force
	$(BIN)/nte evaluate --clips data/quickstart/test --out demo/report --force \
		--denoisers noisy taa:clamp=none taa taa:clamp=clip oidn:quality=fast oidn demo/quickstart.onnx steady

test: $(INSTALLED)
	$(BIN)/pytest -n auto --maxprocesses 8 --dist worksteal -m "not slow"

slow: $(INSTALLED)
	$(BIN)/pytest -n auto --maxprocesses 8 --dist worksteal -m slow

torture: $(INSTALLED)
	$(BIN)/pytest -n auto --maxprocesses 8 --dist worksteal --torture

# Over the fast tests alone: counting lines makes tests of small functions half as slow again (Python 3.11).
coverage: $(INSTALLED)
	$(BIN)/pytest -n auto --maxprocesses 8 --dist worksteal -m "not slow" --cov --cov-report=term-missing:skip-covered

lint: $(INSTALLED)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(MAKE) --no-print-directory viewer-check

viewer: viewer/node_modules
	cd viewer && npm run --silent types && npm run --silent build

# The bundle that is committed must be what its sources give. Without Node or npm's registry only its digest is compared,
# by the tests.
viewer-check:
	@if $(MAKE) --no-print-directory viewer/node_modules; then $(MAKE) --no-print-directory viewer-fresh; \
	else echo "viewer: its bundle was not built again, as npm or its registry is missing"; fi

viewer-fresh: viewer/node_modules
	cd viewer && npm run --silent types && npm run --silent build -- build
	diff -r viewer/build nte/viewer/bundle

viewer/node_modules: viewer/package-lock.json
	cd viewer && npm ci --no-audit --no-fund
	@touch $@

# Strict: a dead link, a missing anchor or a page outside the navigation is an error.
docs: $(INSTALLED)
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# What the demo must have reached; run it after make demo.
acceptance: $(INSTALLED)
	$(BIN)/pytest -s tests/acceptance

paper: $(INSTALLED)
	$(BIN)/nte compare configs/compare_trmv.yaml --data data/trmv --out reports/trmv --jobs 2
	$(BIN)/nte compare configs/compare_trmv_640.yaml --data data/trmv_640 --out reports/trmv_640 --jobs 2
	$(BIN)/nte compare configs/compare_neural.yaml --data data --out reports/neural --jobs 2
	$(BIN)/python -m benchmarks.vectors --pictures reports/vectors
	$(BIN)/python -m benchmarks.correspondence
	$(BIN)/nte render datasets/motion_blur_60.yaml --out data/motion_blur_60
	$(BIN)/python -m benchmarks.motion_blur data/motion_blur_60 --pictures reports/motion_blur

bench: $(INSTALLED)
	$(BIN)/python -m benchmarks.components
	$(BIN)/python -m benchmarks.own_scene
	$(BIN)/python -m benchmarks.kernels
	$(BIN)/python -m benchmarks.motion_blur --times
	$(BIN)/nte bench svgf asvgf trmv taa oidn:quality=fast --size 1280x720 --frames 5

$(INSTALLED): pyproject.toml constraints.txt
	@$(PYTHON) -c "import sys; sys.version_info >= (3, 11) or sys.exit('nte needs Python 3.11 or newer, this is ' + sys.version.split()[0] + ': make PYTHON=python3.11 …')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[render,train,eval,import,cluster,oidn,compare,burst,openvino,video,view,docs,dev]'
	@touch $@

# Before a release, with a network: the lock file, known vulnerabilities of what is in it, and its bill of materials.
supply: $(INSTALLED)
	$(PYTHON) -m venv build/supply
	build/supply/bin/pip install --quiet --disable-pip-version-check uv pip-audit cyclonedx-bom
	head -n 2 requirements.lock > build/requirements.lock
	build/supply/bin/uv pip compile --quiet pyproject.toml --all-extras -c constraints.txt --generate-hashes --universal \
		--python-version 3.11.9 --no-annotate --no-header >> build/requirements.lock
	mv build/requirements.lock requirements.lock
	build/supply/bin/cyclonedx-py requirements requirements.lock --pyproject pyproject.toml -o build/sbom.cdx.json
	$(BIN)/pytest -q tests/test_supply.py
	build/supply/bin/pip-audit --strict -r requirements.lock --require-hashes --disable-pip

# The fast tests in two more environments: with the lowest version that each bound of pyproject.toml allows, and with
# what is newest today. On Linux torch brings CUDA: 7 GB each. make clean removes them.
compat: compat-lowest compat-newest

compat-lowest: VERSIONS = -c build/lowest.txt
compat-newest: VERSIONS = --upgrade
compat-lowest compat-newest: $(INSTALLED)
	$(PYTHON) -m venv build/uv
	build/uv/bin/pip install --quiet --disable-pip-version-check uv
	$(BIN)/python -m tests.lowest > build/lowest.txt
	build/uv/bin/uv venv --quiet --clear --python $(PYTHON) $(VENV)/$@
	build/uv/bin/uv pip install --quiet --python $(VENV)/$@ $(VERSIONS) \
		-e '.[render,train,eval,import,cluster,oidn,compare,burst,openvino,video,view,docs,dev]'
	$(VENV)/$@/bin/pytest -n auto --maxprocesses 8 --dist worksteal -m "not slow"

clean:
	rm -rf $(VENV) build dist site *.egg-info .pytest_cache .mypy_cache .ruff_cache
