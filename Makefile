# make demo: set up and score the example videos.  make test: set up, check and test (some 15 minutes).  make test-all:
# also the exhaustive tests.  make soak: hostile input and killed runs, over and over.  All are safe to repeat.
BIN := .venv/bin
JOBS ?= 2

.PHONY: demo worldmodel-demo test test-all gate soak bench bench-ik bench-audit bench-simulation bench-throughput bench-scale check setup wheel format constraints clean

demo: setup
	$(BIN)/kinebench-drake score examples/videos/manifest.jsonl --out demo-output --overlay
	@echo "Look at demo-output/report.html (the report), demo-output/overlays (what was tracked), demo-output/results.json."

# A small learned world model in closed loop (docs/worldmodel.md): one episode, about a minute.
worldmodel-demo: setup
	$(BIN)/kinebench-drake suite run --suite 3 --tasks PullCube-v1 --episodes 1 --out demo-output/worldmodel \
		--world-model examples.worldmodel.generator:Learned
	@echo "Look at demo-output/worldmodel/report.html, and at rollouts/ (generated and executed side by side)."

# One thread a worker: the networks are small, and threads of several workers would wait for each other. Workers begin
# with whole files, which share what is expensive to set up, and take over from each other at the end.
PYTEST := OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(JOBS) --dist worksteal

test: check
	$(PYTEST) -m "not exhaustive"

test-all: check
	$(PYTEST)

# Short clips of several programs, with and without their cameras: none may come out silently wrong.
gate: setup
	$(BIN)/python -m benchmarks gate --jobs $(JOBS)

# Properties and damaged inputs with thousands of random examples each, then runs that are killed: about an hour.
soak: setup
	$(PYTEST) --hypothesis-profile soak tests/reliability tests/test_properties.py
	for round in $$(seq 20); do $(PYTEST) tests/cli -k "kill or interrupt" || exit 1; done

# Inverse kinematics compared with other packages (installed first), audits, simulation, whole runs of the program, and a
# run of 100,000 samples without its measurements. Results go to benchmarks/results, tables from there
# into the pages; what became worse since the result before is printed.
bench: bench-ik bench-audit bench-simulation bench-throughput bench-scale
	$(BIN)/python -m benchmarks figures

bench-ik bench-audit bench-simulation bench-throughput bench-scale: bench-%: setup
	$(if $(filter bench-ik,$@),-$(BIN)/python -m pip --disable-pip-version-check install --quiet -c setup/constraints.txt -e '.[bench]')
	$(BIN)/python -m benchmarks $*

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

setup:
	setup/install.sh

# dist/kinebench_drake-*.whl. What an earlier build left would go into it, so that is deleted first.
wheel: setup
	rm -rf build
	$(BIN)/python -m pip --disable-pip-version-check wheel --quiet --no-deps --wheel-dir dist .
	rm -rf build
	@ls dist/*.whl

format:
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# Pins what is installed now; run it after a dependency changed and the tests passed.
constraints:
	setup/freeze.sh

clean:
	rm -rf demo-output build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis
