# make demo: the main job on the simulated laboratory.   make test: every check.
# Both set up all they need in .venv, from a fresh clone.
# make test-extras: the other renderers, Mitsuba and Blender (1 GB to install; Blender: Python 3.11).
PYTHON ?= python3
BIN := .venv/bin
OUT ?= out/demo
# The tests that touch OpenCV run a second time with its older major version, laid over the first.
OPENCV4 := .opencv4
# The matrices here are small: threads of BLAS only get into each other's way.
export OPENBLAS_NUM_THREADS := 1

.PHONY: demo test test-extras lint types clean

demo: .venv/ready
	$(BIN)/tronlab demo --out $(OUT)

test: .venv/ready $(OPENCV4)/ready lint types
	$(BIN)/python tests/support/compile_kernels.py
	$(BIN)/pytest -n auto
	PYTHONPATH=$(OPENCV4) $(BIN)/pytest -n auto -m opencv

# The other renderers, each in an environment of its own.
EXTRAS := .extras
BLENDER := .blender

test-extras: $(EXTRAS)/ready $(BLENDER)/ready
	TRONLAB_BLENDER_PYTHON=$(CURDIR)/$(BLENDER)/bin/python \
		$(EXTRAS)/bin/pytest tests/extras tests/unit/render

# The last line: LLVM's package makes its links when Python starts for the first time.
$(EXTRAS)/ready: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(EXTRAS)
	$(EXTRAS)/bin/pip install --quiet --constraint constraints.txt --editable '.[mitsuba,test]'
	$(EXTRAS)/bin/python -c ''
	touch $@

$(BLENDER)/ready:
	python3.11 -m venv $(BLENDER)
	$(BLENDER)/bin/pip install --quiet bpy==5.0.1 'numpy<2'
	touch $@

lint: .venv/ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports

types: .venv/ready
	$(BIN)/pyright

# The camera's GenTL producer, compiled by the installation; see hatch_build.py.
PRODUCER := drivers/gige/producer

.venv/ready: pyproject.toml constraints.txt hatch_build.py $(wildcard $(PRODUCER)/*.[ch])
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[lab,test]'
	touch $@

$(OPENCV4)/ready: .venv/ready
	$(BIN)/pip install --quiet --no-deps --upgrade --target $(OPENCV4) \
		'opencv-contrib-python-headless==4.14.*'
	touch $@

clean:
	rm -rf .venv $(OPENCV4) $(EXTRAS) $(BLENDER) out
