# The checks that run before the tests, here, in .ci/run and in .pre-commit-config.yaml.
#
#   make check                              all of them, with the tools on the path
#   make check BIN=.venv-test/bin/          with the tools of a venv

BIN ?=

.PHONY: check ruff imports types

check: ruff imports types

ruff:
	$(BIN)ruff check .

imports:  # contracts in pyproject.toml; lint-imports looks for packages in the current folder
	$(BIN)lint-imports --no-logo

types:
	$(BIN)mypy
