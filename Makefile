# Leaflight. `make help` lists the targets; nothing has to be installed first but Python 3.11 or 3.13, pip's way to bpy.

PYTHON ?= python3
OUT ?= out
SCENE ?= sample_blends/cornell_box.blend

PYTHON_VERSION := $(shell $(PYTHON) -c 'import sys; print("%d.%d" % sys.version_info[:2])')
ifeq ($(PYTHON_VERSION),)
$(error $(PYTHON) does not run: choose a Python with make PYTHON=python3.11)
endif
VENV := .venv-$(PYTHON_VERSION)
RUN := $(VENV)/bin/python

.PHONY: help bake test pytest bench bench-speed bench-matter bench-files bench-zoo bench-ablation fuzz faults pictures lint zip clean
.DELETE_ON_ERROR:

help:
	@echo "make bake    bake a sample scene into $(OUT)/: images, report, and a .blend that wears them   (SCENE=file.blend OUT=folder)"
	@echo "make test    lint and the everyday tests"
	@echo "make pytest  the everyday tests alone"
	@echo "make bench   the slow tests and the benchmarks, minutes each; ends with one table of what is claimed and measured"
	@echo "make bench-speed  Leaflight beside Cycles on an idle machine, an hour; fills docs/speed.md"
	@echo "make bench-matter  Leaflight beside Cycles on every kind of matter, half an hour and more, goes on where it was stopped; fills docs/matter.md"
	@echo "make bench-files  .blend files of a folder beside Cycles, object by object; fills docs/files.md   (FILES=folder)"
	@echo "make bench-zoo  Leaflight beside Cycles on random scenes, other ones every day   (ZOO='--quick --seeds 1 2 3', or other options)"
	@echo "make bench-ablation  random scenes without each mechanism: what each is worth   (ABLATION='--seeds 1 2 --mechanisms tiles')"
	@echo "make fuzz    1,000 odd scenes, damaged files and odd words, other ones every day   (FUZZ='--seeds 7 8', '--count 100', or other options)"
	@echo "make faults  every fault in a running bake, at every stage, half an hour   (FAULTS='--docs' fills docs/reliability.md)"
	@echo "make pictures  bake all samples and draw them into docs/samples, and the leaves of one into docs/leaves.png"
	@echo "make lint    ruff check, ruff format --check, mypy --strict"
	@echo "make zip     the extension's zips in dist/, one per platform   (WHEELS_DIR=folder: also one with the wheels in it)"
	@echo "make clean   remove what these made, virtual environments included"
	@echo "All take PYTHON=python3.11 or python3.13; each version has a virtual environment of its own."

bake: $(VENV)/.ready
	mkdir -p $(OUT)
	$(RUN) -m leaflight bake $(SCENE) --output $(OUT) --format exr png --save $(OUT)/$(notdir $(basename $(SCENE))).blend --report $(OUT)/report.json

test: lint pytest

# Two at a time, whatever the machine: many tests bake, which takes two processes again. Files in their order: small ones come last, so that
# both processes end together. Where Python is kept from writing bytecode, each of hundreds of processes would compile the package anew.
pytest: $(VENV)/.ready
	PYTHONDONTWRITEBYTECODE= $(RUN) -m pytest -m "not slow" --numprocesses 2 --dist loadfile --no-loadscope-reorder

bench: $(VENV)/.ready-bench
	rm -rf out/claims
	code=0; for script in $(sort $(filter-out %/bench_speed.py %/bench_zoo.py %/bench_matter.py %/bench_files.py %/bench_ablation.py,$(wildcard tests/bench/bench_*.py))) tests/bench/print_claims.py; do \
	  echo "== $$script"; PYTHONPATH=tests $(RUN) $$script || code=1; done; exit $$code

bench-speed: $(VENV)/.ready-bench
	PYTHONPATH=tests $(RUN) tests/bench/bench_speed.py --docs

bench-matter: $(VENV)/.ready-bench
	PYTHONPATH=tests $(RUN) tests/bench/bench_matter.py --docs

bench-files: $(VENV)/.ready-bench
	PYTHONPATH=tests $(RUN) tests/bench/bench_files.py $(FILES) --size 256 --error 0.03 --docs

bench-zoo: $(VENV)/.ready-bench
	PYTHONPATH=tests $(RUN) tests/bench/bench_zoo.py $(ZOO)

bench-ablation: $(VENV)/.ready-bench
	PYTHONPATH=tests $(RUN) tests/bench/bench_ablation.py $(ABLATION)

fuzz: $(VENV)/.ready
	$(RUN) tests/fuzz/run_fuzz.py $(FUZZ)

faults: $(VENV)/.ready
	$(RUN) tests/fuzz/run_faults.py $(FAULTS)

pictures: $(VENV)/.ready
	$(RUN) tests/bench/draw_samples.py
	PYTHONPATH=tests $(RUN) tests/bench/draw_wireframe.py

lint: $(VENV)/.installed
	$(RUN) -m ruff check .
	$(RUN) -m ruff format --check .
ifneq ($(PYTHON_VERSION),3.13) # numpy 1's and numpy 2's types contradict each other here and there: one of them is the reference
	MYPYPATH=$(VENV)/package $(RUN) -m mypy
endif

zip: $(VENV)/.installed
	$(RUN) tools/build_zip.py --output dist $(if $(WHEELS_DIR),--wheels-dir "$(WHEELS_DIR)")

clean:
	rm -rf .venv-* out dist wheels build *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# package/leaflight leads mypy to this folder under the package's name, whatever the folder is called.
$(VENV)/.installed: pyproject.toml
	$(PYTHON) tools/check_system.py --python
	$(PYTHON) -m venv $(VENV)
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable '.[test]'
	mkdir -p $(VENV)/package
	ln -sfn "$(CURDIR)" $(VENV)/package/leaflight
	touch $@

$(VENV)/.ready: $(VENV)/.installed tools/check_system.py
	$(RUN) tools/check_system.py
	touch $@

$(VENV)/.ready-bench: $(VENV)/.ready
	$(RUN) -m pip install --quiet --disable-pip-version-check --editable '.[test,bench]'
	touch $@
