# `make check` runs what .ci/run runs before the tests; BIN=.venv-test/bin/ takes the tools of a venv.
BIN ?=

.PHONY: check
check:
	.ci/check $(BIN)
