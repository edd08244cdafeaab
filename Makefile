# make demo: the main job on the simulated laboratory.   make test: every check.
# Both set up all they need in .venv, from a fresh clone.
PYTHON ?= python3
BIN := .venv/bin
OUT ?= out/demo
# The tests that touch OpenCV run a second time with its older major version, laid over the first.
OPENCV4 := .opencv4
# The matrices here are small: threads of BLAS only get into each other's way.
export OPENBLAS_NUM_THREADS := 1

.PHONY: demo test lint types clean

demo: .venv/ready
	$(BIN)/tronlab demo --out $(OUT)

test: .venv/ready $(OPENCV4)/ready lint types
	$(BIN)/pytest -n auto
	PYTHONPATH=$(OPENCV4) $(BIN)/pytest -n auto -m opencv

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
	rm -rf .venv $(OPENCV4) out
