.DEFAULT_GOAL := help
PYTHON ?= python3
BIN := .venv/bin

help:            ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*##/\t/'

.venv/ready: pyproject.toml
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable '.[bags,dev]'
	@touch $@

demo: .venv/ready   ## calibrate the embedded sample (sets up first)
	$(BIN)/skidsteer calibrate sample:p3at-lab --out build/demo
	@echo "written: build/demo/calibration.yaml, and build/demo/report.html to open in a browser"

test: .venv/ready   ## all tests (sets up first)
	$(BIN)/python -m pytest

lint: .venv/ready   ## ruff and mypy
	$(BIN)/ruff check src tests benchmarks
	$(BIN)/ruff format --check src tests benchmarks
	$(BIN)/mypy

bench: .venv/ready  ## measure speed and memory, writes docs/benchmarks.md
	$(BIN)/python benchmarks/run.py

studies: .venv/ready  ## slow studies on the real drives, writes docs/models.md, docs/coverage.md, docs/yaw-noise.md, docs/design.md, docs/terrains.md, docs/ground.md, docs/plans.md, docs/odometry.md, docs/online-filter.md, docs/path-following.md
	$(BIN)/python -m pip install --quiet --editable '.[studies]'
	$(BIN)/python benchmarks/models.py
	$(BIN)/python benchmarks/coverage.py
	$(BIN)/python benchmarks/yaw_noise.py
	$(BIN)/python benchmarks/design.py
	$(BIN)/python benchmarks/terrain.py
	$(BIN)/python benchmarks/ground.py
	$(BIN)/python benchmarks/plans.py
	$(BIN)/python benchmarks/odometry_study.py
	$(BIN)/python benchmarks/online_filter.py
	$(BIN)/python benchmarks/path_following.py
	$(MAKE) reproduction

reproduction: .venv/ready ## calculate the five papers again, writes docs/reproduction.md and its figures
	$(BIN)/python -m pip install --quiet --editable '.[figures]'
	$(BIN)/skidsteer reproduce all --out docs

figures: .venv/ready ## draw the README's picture from a real drive
	$(BIN)/python -m pip install --quiet --editable '.[figures]'
	$(BIN)/skidsteer figure before-after --drive $${SKIDSTEER_DATA:-../shared/data}/warthog-asphalt --show 50,80 --out docs/figures/readme-warthog.svg

clean:           ## remove everything that was made
	rm -rf .venv build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

.PHONY: help demo test lint bench studies reproduction figures clean
