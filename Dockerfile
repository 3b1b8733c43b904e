# The gateway as a container: docs/container.md says how it is run.
# Which Python of Docker's official images; any that pyproject.toml allows will do.
ARG PYTHON=3.12

# ---- One: a wheel of the gateway, in a virtual environment with what it needs ----------------------------------------
FROM python:${PYTHON}-slim AS build
ENV PIP_DISABLE_PIP_VERSION_CHECK=1 PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore
WORKDIR /build
# pip stays out of the environment that runs: it works on it from one of its own.
RUN python -m venv tools && python -m venv --without-pip /opt/robot-gateway

# What the gateway stands on changes seldom: a layer of its own. Only finished wheels, nothing is compiled; nkeys, plain
# Python, has none.
COPY pyproject.toml packaging/constraints.txt ./
RUN python -c "import tomllib; p = tomllib.load(open('pyproject.toml', 'rb'))['project']; print(*p['dependencies'], *p['optional-dependencies']['nats'], sep='\n')" \
        > requirements.txt \
    && tools/bin/pip --python /opt/robot-gateway/bin/python install --only-binary :all: --no-binary nkeys \
        --constraint constraints.txt --requirement requirements.txt

COPY README.md LICENSE ./
COPY config/gateway.toml config/
COPY systemd systemd
COPY gateway gateway
COPY vendors vendors
RUN tools/bin/pip wheel --no-deps --wheel-dir dist . \
    && tools/bin/pip --python /opt/robot-gateway/bin/python install --no-index --no-deps dist/*.whl

# ---- Two: what runs --------------------------------------------------------------------------------------------------
FROM python:${PYTHON}-slim
COPY --from=build /opt/robot-gateway /opt/robot-gateway
# The one place that is written to: the control socket. And Python's own modules come without bytecode in the slim
# images; what the gateway imports of them is compiled now, because later nothing can be written.
RUN install -d -m 0750 -o 10001 -g 10001 /run/robot-gateway \
    && /opt/robot-gateway/bin/python -c "import gateway.app, gateway.cli.run, gateway.cli.health"

ENV PATH=/opt/robot-gateway/bin:$PATH \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1 \
    OPENBLAS_NUM_THREADS=1 \
    ROBOT_GATEWAY_CONFIG=/etc/robot-gateway/gateway.toml
WORKDIR /etc/robot-gateway
# A number, so that Kubernetes' runAsNonRoot can see that it is not root.
USER 10001:10001
EXPOSE 8765
STOPSIGNAL SIGTERM
HEALTHCHECK --interval=30s --timeout=5s --start-period=15s --retries=3 CMD ["robot-gateway", "health"]
ENTRYPOINT ["robot-gateway"]
CMD ["run"]

# Last, because they change with every commit.
ARG VERSION=unknown
ARG REVISION=unknown
LABEL org.opencontainers.image.title="robot-gateway" \
      org.opencontainers.image.description="Reads every robot controller in the cell, whatever the brand, and serves one honest, well-described stream. It only observes." \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.documentation="docs/container.md" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
