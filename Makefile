# `make check` runs what .ci/run runs beside the tests; BIN=.venv-test/bin/ takes the tools of a venv.
BIN ?=

.PHONY: check
check:
	.ci/check $(BIN)
