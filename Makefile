# make demo: set up and score the example videos.  make test: set up and run every check.  Both are safe to repeat.
BIN := .venv/bin
JOBS ?= 2

.PHONY: demo test bench check setup wheel format constraints clean

demo: setup
	$(BIN)/kinebench-drake score examples/videos/manifest.jsonl --out demo-output --overlay
	@echo "Look at demo-output/report.html (the report), demo-output/overlays (what was tracked), demo-output/results.json."

test: check
	$(BIN)/python -m pytest -n $(JOBS)

# Inverse kinematics beside that of other packages (installed first), audits, simulation, whole runs of the program, and
# memory over 2,000 samples: about an hour on two cores.
bench: setup
	-$(BIN)/python -m pip --disable-pip-version-check install --quiet -c setup/constraints.txt -e '.[bench]'
	$(BIN)/python -m benchmarks bench --out docs/benchmarks.md
	$(BIN)/python -m benchmarks.simulation --out docs/benchmarks.md
	$(BIN)/python -m benchmarks throughput --out docs/benchmarks.md
	$(BIN)/python -m benchmarks streaming --out docs/benchmarks.md

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
