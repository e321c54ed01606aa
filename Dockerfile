# The gateway in a container; deploy/README.md says how to run it.

FROM python:3.11-slim AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /build
# What others made changes seldom, and is taken by hash; our own code changes often.
COPY requirements.lock requirements-build.lock ./
RUN pip wheel --require-hashes --no-deps --only-binary :all: --wheel-dir wheels -r requirements.lock \
 && pip install --require-hashes --no-deps --only-binary :all: -r requirements-build.lock
COPY pyproject.toml README.md LICENSE ./
COPY gateway gateway
RUN pip wheel --no-deps --no-build-isolation --wheel-dir wheels . \
 && python -m venv --without-pip /opt/tosvert-gateway \
 && pip --python /opt/tosvert-gateway/bin/python install --no-index --no-deps wheels/*.whl

FROM python:3.11-slim
# dialout: serial ports that are passed in belong to it (20 in Debian; --group-add where the host differs).
RUN useradd --system --uid 10001 --groups dialout --no-create-home --shell /usr/sbin/nologin tosvert-gateway
COPY --from=build /opt/tosvert-gateway /opt/tosvert-gateway
COPY deploy/healthcheck.py /opt/tosvert-gateway/healthcheck.py
ENV PATH=/opt/tosvert-gateway/bin:$PATH PYTHONDONTWRITEBYTECODE=1 RUNTIME_DIRECTORY=/run/tosvert-gateway
USER tosvert-gateway
EXPOSE 5020 8080
# Healthy means that all data are fresh. TOSVERT_WEB=host:port where [web] listens elsewhere than on port 8080.
HEALTHCHECK --interval=10s --timeout=5s --start-period=30s --retries=3 \
  CMD ["python", "/opt/tosvert-gateway/healthcheck.py"]
ENTRYPOINT ["tosvert-gateway"]
CMD ["run", "/etc/tosvert-gateway/gateway.toml"]
