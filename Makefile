# `make budget` sets up and runs the main job, `make test` sets up and runs every test. ARGS is passed on to either.
SHELL := /bin/sh
PYTHON_VENV := .venv/bin/python
READY := .venv/.ready

.PHONY: setup budget test coverage lint quick docs bench clean
.DEFAULT_GOAL := budget

setup: $(READY)

$(READY): pyproject.toml scripts/setup-venv.sh scripts/setup-llvm.sh
	sh scripts/setup-venv.sh
	sh scripts/setup-llvm.sh $(PYTHON_VENV)
	@touch $@

budget: setup
	.venv/bin/mantis budget --out out/budget $(ARGS)

# Rendering fills all cores by itself, so two workers only bridge its gaps; BLAS threads would compete with both.
test: export OPENBLAS_NUM_THREADS := 1
test: setup
	$(PYTHON_VENV) -m pytest -n 2 --dist loadfile $(ARGS)

# Every test, and how much of the code they run; fails below the floor of pyproject.toml. What is compiled (numba, Dr.Jit) is not
# seen, nor what workers do in processes of their own.
coverage: export OPENBLAS_NUM_THREADS := 1
coverage: setup
	$(PYTHON_VENV) -m pytest -n 2 --dist loadfile --cov --cov-report=term $(ARGS)

lint: setup
	.venv/bin/ruff check .
	.venv/bin/ruff format --check .
	.venv/bin/mypy

# Every study in its short form, as CI runs it.
quick: setup
	.venv/bin/mantis doctor
	.venv/bin/mantis budget --quick --out out/quick/budget
	.venv/bin/mantis validate --quick --require agrees --out out/quick/validate
	rm -rf out/quick/emva1288 && .venv/bin/mantis sensor emva1288 --out out/quick/emva1288
	.venv/bin/mantis materials --out out/quick/materials
	.venv/bin/mantis glare --quick --out out/quick/glare
	.venv/bin/mantis close --quick --out out/quick/close
	.venv/bin/mantis errata --out out/quick/errata
	.venv/bin/mantis tradeoff --out out/quick/tradeoff
	OPENBLAS_NUM_THREADS=1 .venv/bin/mantis montecarlo --quick --out out/quick/montecarlo
	.venv/bin/mantis layout --quick --out out/quick/layout
	.venv/bin/mantis fov --quick --out out/quick/fov
	.venv/bin/mantis power --quick --out out/quick/power
	.venv/bin/mantis comparison --quick --out out/quick/comparison
	.venv/bin/mantis requirements --out out/quick/requirements
	.venv/bin/mantis virtual --quick --require targets --out out/quick/virtual
	.venv/bin/mantis features --quick --out out/quick/features
	.venv/bin/mantis physical --quick --require found --out out/quick/physical
	.venv/bin/mantis risk --out out/quick/risk

# The documentation as a site, out/site/index.html; warnings are errors. It runs the notebook.
docs: .venv/.docs-ready
	$(PYTHON_VENV) -m sphinx -W --keep-going --quiet --fresh-env --jobs 2 -b html -d out/doctrees docs out/site
	@echo "docs: out/site/index.html"

.venv/.docs-ready: $(READY)
	$(PYTHON_VENV) -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@

# Figures of speed, beside those of peers where they are installed (benchmarks/peers.py): docs/performance.md.
bench: setup
	$(PYTHON_VENV) -m benchmarks $(ARGS)

clean:
	rm -rf .venv out build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
