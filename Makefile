# Set-up, checks and tests. `make help` lists the targets; each does all the set-up that it needs.
.POSIX:

VENV = .venv
BIN = $(VENV)/bin
PYTHON =
DEMO_ARGS =
TEST_ARGS =
SOAK = 10
LOCK_ARGS =
BENCH_ARGS =
ACCEPT =
HOUSE = .home-assistant
HOME_ASSISTANT_PYTHON = python3.13
PROVE_ARGS =
FOREIGN = tools/foreign
UV = uv>=0.9,<1
PIP = tools/quietly $(BIN)/python -m pip --disable-pip-version-check --no-input
FROM_LOCK = install --require-hashes --no-deps
LOCK = $(BIN)/uv pip compile -q --universal --generate-hashes --python-version 3.11 \
	--custom-compile-command "make lock"
LOCK_HOUSE = $(BIN)/uv pip compile -q --universal --generate-hashes --python-version 3.13 \
	--custom-compile-command "make lock"

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## /\1#/p' Makefile | awk -F'#' '{ printf "make %-15s%s\n", $$1, $$2 }'

demo: $(VENV)/.demo $(VENV)/.package ## show the main job without hardware (DEMO_ARGS="--mqtt-port 11883")
	@$(BIN)/tosvert-gateway demo $(DEMO_ARGS)

check: $(VENV)/.dev $(VENV)/.package ## lint, types, import contract, generated files, lock files
	$(BIN)/ruff check -q
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo
	@$(BIN)/tosvert-gateway schema | diff -u config/schema.json - || \
		{ echo 'config/schema.json is not current: run `make generate`' >&2; exit 1; }
	$(BIN)/python -m tools.locks
	$(BIN)/python -m tools.licences --check
	$(BIN)/python -m tools.hazards --check

test: $(VENV)/.dev $(VENV)/.package programs $(VENV)/.foreign ## all tests, with branch coverage (TEST_ARGS="-k web")
	@PATH="$$PATH:/usr/sbin" $(BIN)/python -m tools.suite $(TEST_ARGS)

test-quick: $(VENV)/.dev $(VENV)/.package ## the tests that need no other programs
	@$(BIN)/pytest -q -n auto -m "not e2e" $(TEST_ARGS)

soak: $(VENV)/.dev $(VENV)/.package programs $(VENV)/.foreign ## the tests with ten times as many inputs (SOAK=100: a hundred times)
	@PATH="$$PATH:/usr/sbin" TOSVERT_SOAK=$(SOAK) $(BIN)/python -m tools.suite $(TEST_ARGS)

home-assistant: $(VENV)/.dev $(VENV)/.package $(HOUSE)/.made programs ## let Home Assistant's own code judge what it is told (ACCEPT=1: remember it)
	@PATH="$$PATH:/usr/sbin" TOSVERT_ACCEPT=$(ACCEPT) $(BIN)/pytest -q tests/home_assistant $(TEST_ARGS)

prove: $(VENV)/.dev $(VENV)/.package programs ## prove that the tests of each hazard fail without its rule (PROVE_ARGS="H05")
	@PATH="$$PATH:/usr/sbin" $(BIN)/python -m tools.prove $(PROVE_ARGS)
	@$(BIN)/python -m tools.hazards

bench: $(VENV)/.dev $(VENV)/.package peers ## measure line use, latencies and MODBUS-TCP, beside other programs (BENCH_ARGS=--quick)
	@$(BIN)/python -m bench.run $(BENCH_ARGS)

generate: $(VENV)/.dev $(VENV)/.package ## write the generated files anew: JSON Schema, table of licences, hazards
	$(BIN)/tosvert-gateway schema > $(VENV)/schema.json && mv $(VENV)/schema.json config/schema.json
	$(BIN)/python -m tools.licences
	$(BIN)/python -m tools.hazards

lock: $(VENV)/.dev ## bring the lock files up to pyproject.toml (LOCK_ARGS=--upgrade: to the newest versions)
	@$(PIP) install '$(UV)'
	$(LOCK) $(LOCK_ARGS) --extra demo -o requirements.lock pyproject.toml
	$(LOCK) $(LOCK_ARGS) --group build -o requirements-build.lock
	$(LOCK_HOUSE) $(LOCK_ARGS) --group home-assistant -o tests/home_assistant/requirements.lock
	$(LOCK) $(LOCK_ARGS) --extra demo --group dev --group bench --group build \
		-c requirements.lock -c requirements-build.lock -o requirements-dev.lock pyproject.toml
	$(LOCK) $(LOCK_ARGS) -o $(FOREIGN)/requirements.lock $(FOREIGN)/requirements.in
	cd $(FOREIGN) && npm install --package-lock-only --ignore-scripts --omit-lockfile-registry-resolved
	$(BIN)/python -m tools.locks

programs: # what the tests start beside Python
	@tools/need-packages "make test" mosquitto:mosquitto mosquitto_sub:mosquitto-clients mbpoll:mbpoll tshark:tshark \
		node:nodejs npm:npm

peers: # what the benchmarks start beside Python, and what they compile with
	@tools/need-packages "make bench" mosquitto:mosquitto gcc:gcc gcc:libc6-dev
	@test -e /usr/include/modbus/modbus.h || tools/need-packages "make bench" :libmodbus-dev

clean: ## remove what make has made
	rm -rf $(VENV) $(HOUSE) build dist *.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	rm -rf .coverage htmlcov
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

# The virtual environment is made anew when a lock file changes; the stamps are its contents.
$(VENV)/.made: requirements.lock requirements-dev.lock requirements-build.lock
	@PYTHON="$(PYTHON)" tools/make-venv $(VENV)
	@$(PIP) $(FROM_LOCK) -r requirements-build.lock
	@touch $@

$(HOUSE)/.made: tests/home_assistant/requirements.lock
	@HOME_ASSISTANT_PYTHON="$(HOME_ASSISTANT_PYTHON)" tools/make-home-assistant $(HOUSE)
	@touch $@

$(VENV)/.demo: $(VENV)/.made
	@echo "installing what the gateway needs"
	@$(PIP) $(FROM_LOCK) -r requirements.lock
	@touch $@

$(VENV)/.dev: $(VENV)/.made
	@echo "installing what checks and tests need"
	@$(PIP) $(FROM_LOCK) -r requirements-dev.lock
	@touch $@

# By these the tests judge what the gateway sends as Sparkplug; apart, for they want another paho-mqtt.
$(VENV)/.foreign: $(VENV)/.made $(FOREIGN)/requirements.lock $(FOREIGN)/package-lock.json
	@echo "installing decoders of others for the tests"
	@rm -rf $(VENV)/foreign && mkdir -p $(VENV)/foreign/node
	@$(PIP) $(FROM_LOCK) --no-build-isolation --target $(VENV)/foreign/python -r $(FOREIGN)/requirements.lock
	@cp $(FOREIGN)/package.json $(FOREIGN)/package-lock.json $(VENV)/foreign/node
	@cd $(VENV)/foreign/node && ../../../tools/quietly npm ci --ignore-scripts --no-audit --no-fund
	@touch $@

$(VENV)/.package: $(VENV)/.made pyproject.toml
	@$(PIP) install --no-deps --no-build-isolation -e .
	@touch $@

.PHONY: help demo check test test-quick soak home-assistant prove bench generate lock programs peers clean
