# `make demo` and `make test` do everything from a clean clone; see README.md.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

PY := .venv/bin/python
CLI := target/release/mvtop-cli
# There once the wheel is installed, which data and training use.
MVTOP := .venv/bin/mvtop-cli
WHEELS := target/wheels
# A model and an example that the wheel carries.
SHIPPED := crates/mvtop-py/python/mvtop/shipped
export PYTHONPATH := training
# ONNX Runtime for what cargo builds: nothing is looked for in the current folder.
RUNTIME = ORT_DYLIB_PATH="$$(ls -d "$(CURDIR)"/.venv/lib/python*/site-packages/onnxruntime/capi/libonnxruntime.[s1]*)"
export CARGO_TERM_PROGRESS_WHEN ?= auto
# Property tests draw the same cases in every run; set another seed to search for new ones.
export PROPTEST_RNG_SEED ?= 1

SPLIT ?= hard
SEED ?= 0
PAIRS ?= 100
VIEWS ?= 2
CASES ?= 100000
PREDICTIONS ?= 10000
KILLED ?= 20
REQUESTS ?= 20000
LOAD_SECONDS ?= 60
CONFIG ?= parts
MIRI = six_locations_worked_by_hand gradients_worked_by_hand locations_that_are_not_finite_contribute_nothing \
  a_tap_of_weight_zero_does_not_read arrays_that_do_not_belong_together_are_refused empty_axes_give_empty_or_zero_results
MODEL ?= models/mvball
SAMPLES = out/eval/$(SPLIT)-seed$(SEED)-views$(VIEWS)-$(PAIRS)

OUT ?= out/accuracy.json
MODEL_PARTS ?= models/parts
ACCURACY = $(PY) -m mvtop_train.evaluation.accuracy
BASELINE = training/tests/accuracy-baseline.json

# Of `detector`: JSON with every score.
DETECTOR = out/detector-$(notdir $(patsubst %/,%,$(MODEL))).json

# Of lies: a test set or a folder; VIEWS counts where it is given.
SET ?= ball-short
LIE_VIEWS = $(if $(filter-out file,$(origin VIEWS)),$(VIEWS))
LIES = out/lies/$(notdir $(MODEL))-$(notdir $(patsubst %/,%,$(SET)))$(addprefix -,$(LIE_VIEWS)).jsonl

# Views of the samples that the tables are from (tables.py).
MOST_hard = 8
MOST_easy = 2
TABLES = out/tables/$(notdir $(MODEL))-seed$(SEED)-$(PAIRS)

.PHONY: help demo test built-tests test-rust test-python lint fuzz soak soak-serve miri fixtures eval accuracy test-accuracy accuracy-baseline detector \
  lies tables pictures bench bench-peers bench-predict bench-serve bench-train wheel release-wheel release-wheel-aarch64 test-wheel stubs reference site licences test-ray \
  test-page test-ros

help:  ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/' | expand -t 24

demo: .venv/run.done $(CLI)  ## poses of the shipped two-view example, with overlay pictures
	$(RUNTIME) $(CLI) infer --rig examples/mvball/rig.json examples/mvball/*.png \
	  --truth examples/mvball/truth.json --overlay out/demo --force

test:  ## every test, format and lint check
	$(MAKE) --no-print-directory -j2 .venv/test.done built-tests # pip unpacks while cargo compiles
	$(MAKE) --no-print-directory lint test-rust test-python test-wheel test-accuracy

.PHONY: check links
check: lint test-rust links  ## format, lint, Rust tests, links of the docs: minutes, without PyTorch

links: .venv/lint.done
	$(PY) -m pytest -q scripts

built-tests:
	cargo test --release --workspace --no-run

test-rust: .venv/run.done
	$(RUNTIME) cargo test --release --workspace

test-python: .venv/test.done $(MVTOP)
	scripts/need-gl.sh
	$(PY) -m pytest -q scripts # links and generated pages of the docs
	$(PY) -m pytest -q training/tests
	$(PY) -m mvtop_train.export.fixtures --check

lint: .venv/lint.done
	cargo fmt --all --check
	rustfmt --check --edition 2024 crates/mvtop-geometry/src/camera/*.rs # declared by a macro, which cargo fmt does not read
	cargo clippy --release --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --release --workspace --exclude mvtop-benches --no-deps --quiet
	cargo package --workspace --exclude mvtop-benches --no-verify --allow-dirty --quiet
	scripts/licences.py --check crates/mvtop-py/THIRD-PARTY-LICENCES.txt
	scripts/deny.sh
	$(PY) -m ruff check training crates/mvtop-py
	$(PY) -m ruff check --config crates/mvtop-py/pyproject.toml examples benches crates/mvtop-serve ros2 scripts/bench-serve.py
	$(PY) -m ruff format --check training crates/mvtop-py
	$(PY) -m ruff format --check --config crates/mvtop-py/pyproject.toml examples benches crates/mvtop-serve ros2 scripts/bench-serve.py

wheel: $(MVTOP) $(WHEELS)/built-train  ## the Python wheels of mvtop, installed in .venv, and of mvtop-train, in target/wheels

# What panics say of files, without where the builder has them.
UNNAMED = --remap-path-prefix=$(or $(CARGO_HOME),$(HOME)/.cargo)=/cargo --remap-path-prefix=$(CURDIR)=/mvtop

# As old a glibc as onnxruntime's own wheels ask for; zig links against any. On PATH, as maturin
# calls `python -m ziglang`. LTO takes minutes and saves 0.6 MB.
RELEASE = PATH="$(CURDIR)/.venv/bin:$$PATH" RUSTFLAGS="$(UNNAMED)" CARGO_PROFILE_RELEASE_LTO=fat \
  $(PY) -m maturin build --release --strip --locked --zig \
  --compatibility manylinux_2_28 -m crates/mvtop-py/Cargo.toml --out out/wheels

release-wheel: .venv/release.done $(SHIPPED)/model/model.json $(WHEELS)/built-train  ## both wheels, for every Linux with glibc 2.28 (2018) or newer, in out/wheels
	rm -f out/wheels/mvtop-*_$$(uname -m).whl out/wheels/mvtop_train-*.whl
	$(RELEASE)
	scripts/names-no-home.py out/wheels/mvtop-*_$$(uname -m).whl
	scripts/try-wheel.sh out/wheels/mvtop-*_$$(uname -m).whl
	cp $(WHEELS)/mvtop_train-*.whl out/wheels

release-wheel-aarch64: .venv/release.done $(SHIPPED)/model/model.json  ## that of mvtop for aarch64; RELEASING.md
	rm -f out/wheels/mvtop-*_aarch64.whl
	$(RELEASE) --target aarch64-unknown-linux-gnu
	scripts/names-no-home.py out/wheels/mvtop-*_aarch64.whl

test-wheel: .venv/test.done $(MVTOP)
	scripts/try-wheel.sh $(WHEELS)/mvtop-*.whl
	$(PY) -m pytest -q crates/mvtop-py/tests
	$(PY) -m maturin generate-stubs --profile release --locked -m crates/mvtop-py/Cargo.toml \
	  --out out/stubs
	diff out/stubs/mvtop/_mvtop.pyi crates/mvtop-py/python/mvtop/_mvtop.pyi # else: make stubs
	$(PY) -m mypy --config-file crates/mvtop-py/pyproject.toml crates/mvtop-py/python \
	  examples/infer.py examples/ray_bop.py

stubs: .venv/data.done  ## write the types of the Python module's compiled part anew
	$(PY) -m maturin generate-stubs --profile release --locked -m crates/mvtop-py/Cargo.toml \
	  --out crates/mvtop-py/python

reference: $(MVTOP)  ## write the generated pages of docs/reference anew
	$(PY) scripts/reference.py

site: .venv/site.done  ## the documentation as a site, in out/site
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict

licences:  ## gather the licences of the crates that the wheel is built of anew
	scripts/licences.py --out crates/mvtop-py/THIRD-PARTY-LICENCES.txt

test-ray: test-wheel .venv/ray.done  ## a whole BOP data set on a local Ray cluster, a worker killed
	$(PY) -m pytest -q examples

test-page: .venv/page.done $(CLI)  ## the service's page in a real browser; writes docs/images/serve.jpg
	scripts/need-chromium.sh
	$(RUNTIME) MVTOP_CLI="$(CURDIR)/$(CLI)" MVTOP_SCREENSHOT="$(CURDIR)/docs/images/serve.jpg" \
	  $(PY) -m pytest -q crates/mvtop-serve/tests

test-ros: .venv/ros.done $(WHEELS)/built  ## the ROS 2 nodes as processes over DDS, with ROS 2 from Python wheels
	$(ROS_PY) -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps $(WHEELS)/mvtop-*.whl
	PYTHONPATH=ros2/mvtop_ros ROS_LOG_DIR="$(CURDIR)/out/ros" $(ROS_PY) -m pytest -q ros2/mvtop_ros/test

fuzz: .venv/test.done  ## readers of every kind of file, rigs, meshes, trackers, changed at random: CASES=n for each
	$(RUNTIME) PROPTEST_CASES=$(CASES) PROPTEST_RNG_SEED=$$RANDOM cargo test --release -p mvtop-core -p mvtop-eval -p mvtop-import --test fuzz
	$(RUNTIME) CASES=$(CASES) $(PY) -m pytest -q training/tests/test_mesh_fuzz.py

soak: $(MVTOP)  ## many predictions, reloads, kills and resumes: PREDICTIONS=n KILLED=n
	$(PY) scripts/soak.py --predictions $(PREDICTIONS) --killed $(KILLED)

soak-serve: .venv/run.done $(CLI)  ## many requests to the service, some broken, some clients gone: REQUESTS=n
	$(RUNTIME) $(PY) scripts/soak_serve.py --cli $(CLI) --requests $(REQUESTS)

# Tree Borrows: what rayon builds on breaks the stricter rules. The library never ends its threads.
miri:  ## index arithmetic of the sampling kernel under Miri; needs a nightly toolchain with miri and rust-src
	MIRIFLAGS="-Zmiri-disable-isolation -Zmiri-tree-borrows -Zmiri-ignore-leaks -Zmiri-permissive-provenance" \
	  RAYON_NUM_THREADS=1 cargo +nightly miri test -p mvtop-core --lib -- --exact \
	  $(addprefix sampling::tests::,$(MIRI))

fixtures: .venv/test.done $(MVTOP)  ## write the parity fixtures anew
	$(PY) -m mvtop_train.export.fixtures

eval: $(MVTOP)  ## held-out scenes: SPLIT=hard|easy SEED=n PAIRS=n VIEWS=n
	scripts/need-gl.sh
	$(PY) -m mvtop_train.synthesis.samples --out $(SAMPLES) --split $(SPLIT) --seed $(SEED) \
	  --count $(PAIRS) --views $(VIEWS)
	$(MVTOP) eval samples $(SAMPLES) --model $(MODEL)

accuracy: .venv/test.done $(MVTOP)  ## recall, false positives, calibration on fixed test sets: OUT=file; resumes
	scripts/need-gl.sh
	$(ACCURACY) run --out $(OUT) --model-parts $(MODEL_PARTS)

test-accuracy: out/accuracy-short.json  ## a small part of it, compared with what it was
	$(ACCURACY) compare $(BASELINE) $< --fail-if-worse

accuracy-baseline: out/accuracy-short.json  ## what test-accuracy compares with, written anew
	cp $< $(BASELINE)

# Always anew: models and code change.
.PHONY: out/accuracy-short.json
out/accuracy-short.json: .venv/test.done $(MVTOP)
	scripts/need-gl.sh
	rm -f $@
	$(ACCURACY) run --out $@ --set ball-short

detector: .venv/test.done $(MVTOP)  ## boxes that a bundle's detector finds in single images, before any pose: MODEL=dir
	scripts/need-gl.sh
	rm -f $(DETECTOR)
	$(PY) -m mvtop_train.evaluation.detector --model $(MODEL) --out $(DETECTOR)

lies: .venv/test.done $(MVTOP)  ## wrong calibrations and images, and what becomes of them: MODEL=dir SET=name or folder VIEWS=n; resumes
	scripts/need-gl.sh
	$(PY) -m mvtop_train.evaluation.lies run --model $(MODEL) --set $(SET) $(addprefix --views ,$(LIE_VIEWS)) --out $(LIES)

tables: .venv/tables.done $(MVTOP)  ## errors over views and noise, tables and curves: SEED=n PAIRS=n; resumes
	scripts/need-gl.sh
	$(PY) -m mvtop_train.study.tables --cli $(MVTOP) --model $(MODEL) --seed $(SEED) --pairs $(PAIRS) --out $(TABLES)

pictures: tables  ## poses from one and from two views, drawn beside each other: SPLIT=hard|easy
	$(PY) -m mvtop_train.study.pictures --cli $(MVTOP) --model $(MODEL) --split $(SPLIT) --results $(TABLES) \
	  --samples out/eval/$(SPLIT)-seed$(SEED)-views$(MOST_$(SPLIT))-$(PAIRS) --out $(TABLES)/pairs-$(SPLIT).png

bench: .venv/run.done  ## criterion benches
	$(RUNTIME) cargo bench -p mvtop-benches

bench-peers: .venv/test.done $(MVTOP)  ## beside other runtimes on the same network, times and memory: docs/benchmarks.md
	$(PY) benches/peers.py --out out/peers

bench-predict: .venv/test.done  ## whole predictions over pixels, cameras, objects and classes: out/predict
	$(PY) benches/predict.py

bench-train: .venv/test.done $(MVTOP)  ## a step of training beside the processor's bound: CONFIG=name
	$(PY) benches/throughput.py --config $(CONFIG)

bench-serve: .venv/run.done $(CLI)  ## the service under load of 1, 2, 4 and 8 clients: LOAD_SECONDS=n of each
	$(RUNTIME) $(PY) scripts/bench-serve.py --cli $(CLI) --seconds $(LOAD_SECONDS)

# Always asked: cargo knows best what is stale.
.PHONY: $(CLI)
$(CLI):
	cargo build --release -p mvtop-cli

.venv/run.done: requirements.txt
	python3 -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check -r requirements.txt
	touch $@

.venv/site.done: .venv/run.done scripts/site-requirements.txt
	$(PY) -m pip install --quiet --disable-pip-version-check -r scripts/site-requirements.txt
	touch $@

# Exact versions; the ranges that mvtop-train asks for are in training/pyproject.toml.
.venv/page.done: .venv/run.done scripts/page-requirements.txt
	$(PY) -m pip install --quiet --disable-pip-version-check -r scripts/page-requirements.txt
	touch $@

.venv/lint.done: .venv/run.done training/requirements/lint.txt
	$(PY) -m pip install --quiet --disable-pip-version-check -r training/requirements/lint.txt
	touch $@

# An environment of its own: its message packages are built into it.
ROS_PY := .venv/ros/bin/python
ROS_MESSAGES := $(wildcard ros2/test_interfaces/*_msgs) ros2/mvtop_interfaces ros2/ibpc_interfaces
.venv/ros.done: requirements.txt ros2/requirements.txt scripts/ros-interfaces.sh $(shell find ros2/*_interfaces -type f)
	rm -rf .venv/ros
	python3 -m venv .venv/ros
	$(ROS_PY) -m pip install --quiet --disable-pip-version-check -r requirements.txt -r ros2/requirements.txt
	scripts/ros-interfaces.sh .venv/ros $(ROS_MESSAGES)
	touch $@

.venv/%.done: .venv/run.done training/pyproject.toml $(wildcard training/requirements/*.txt)
	$(PY) -m pip install --quiet --disable-pip-version-check -r training/requirements/$*.txt
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e training
	touch $@

$(MVTOP): $(WHEELS)/built
	$(PY) -m pip install --quiet --disable-pip-version-check --force-reinstall --no-deps \
	  $(WHEELS)/mvtop-*.whl
	touch $@

$(SHIPPED)/model/model.json: $(wildcard models/mvball/* examples/mvball/*)
	rm -rf $(SHIPPED)
	mkdir -p $(SHIPPED)
	cp -r models/mvball $(SHIPPED)/model
	cp -r examples/mvball $(SHIPPED)/example
	touch $@

$(WHEELS)/built: .venv/data.done $(SHIPPED)/model/model.json Cargo.toml Cargo.lock $(shell find crates -type f -not -path '*/tests/*')
	rm -f $(WHEELS)/mvtop-*.whl
	$(PY) -m maturin build --release --strip --locked -m crates/mvtop-py/Cargo.toml --out $(WHEELS)
	touch $@

# Without training/build, whose files of before would be in the wheel.
$(WHEELS)/built-train: .venv/data.done $(shell find training/mvtop_train training/pyproject.toml training/README.md -type f -not -name '*.pyc')
	rm -rf $(WHEELS)/mvtop_train-*.whl training/build
	$(PY) -m pip wheel --quiet --disable-pip-version-check --no-deps --no-build-isolation \
	  --wheel-dir $(WHEELS) ./training
	rm -rf training/build
	touch $@
