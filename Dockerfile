# One image for every role: `IMAGE edge-service serve`, `IMAGE drone-client ...`, `IMAGE load-test ...`.
# docs/deploy.md says how to build it small, and what it needs at run time.

ARG BASE_IMAGE=python:3.11-slim-bookworm

FROM ${BASE_IMAGE} AS packages
# No pip inside the environment: the builder's own fills it, and nothing can be added at run time.
ENV PIP_PYTHON=/opt/aerial-contact/venv/bin/python \
    PIP_DISABLE_PIP_VERSION_CHECK=1 \
    PIP_NO_CACHE_DIR=1
RUN python -m venv --without-pip /opt/aerial-contact/venv

# torch first and by itself, so that an index given for it serves nothing else. Empty: the default
# index, whose Linux builds bring gigabytes of CUDA along; an index with CPU builds saves them.
# (pip passes over an empty variable.)
ARG TORCH_INDEX_URL=
ARG TORCH_VERSION=2.13.0
RUN PIP_INDEX_URL="${TORCH_INDEX_URL}" pip install "torch==${TORCH_VERSION}"

# All that the project needs, and not the project: this layer holds nearly all of the image and
# stays the same when only code changes.
WORKDIR /build
COPY pyproject.toml README.md LICENSE ./
# More engines for the detector: drone,edge,onnxruntime or drone,edge,openvino
ARG EXTRAS=drone,edge
# hadolint ignore=DL3013 # the project itself; pyproject.toml bounds the versions
RUN pip install ".[${EXTRAS}]" && pip uninstall --yes aerial-contact

FROM packages AS project
COPY rgbd_wire rgbd_wire
COPY target_pose target_pose
COPY edge_service edge_service
COPY drone_client drone_client
RUN pip install --no-deps --target /opt/aerial-contact/project .

FROM ${BASE_IMAGE}
# Whoever the container runs as may write to /runs, and to a new volume that is mounted there.
RUN groupadd --gid 10001 aerial \
    && useradd --uid 10001 --gid 10001 --no-log-init --no-create-home --home-dir /tmp \
    --shell /usr/sbin/nologin aerial \
    && install --directory --owner=10001 --group=10001 --mode=1777 /runs

COPY --from=packages /opt/aerial-contact/venv /opt/aerial-contact/venv
COPY --from=project /opt/aerial-contact/project /opt/aerial-contact/project
COPY LICENSE /opt/aerial-contact/
COPY examples /opt/aerial-contact/examples

# Nothing is written but below /tmp and /runs: the root file system may be read-only, the uid any.
ENV PATH=/opt/aerial-contact/project/bin:/opt/aerial-contact/venv/bin:${PATH} \
    PYTHONPATH=/opt/aerial-contact/project \
    HOME=/tmp \
    MPLCONFIGDIR=/tmp/matplotlib \
    PYTHONDONTWRITEBYTECODE=1 \
    PYTHONUNBUFFERED=1
WORKDIR /opt/aerial-contact
USER 10001:10001
EXPOSE 7447/tcp 7448/udp 8080/tcp

# Of use to the service alone; whoever runs another role switches it off (see compose.yaml).
HEALTHCHECK --interval=10s --timeout=3s --start-period=60s --retries=3 \
    CMD ["python", "-c", "from urllib.request import *; build_opener(ProxyHandler({})).open('http://127.0.0.1:8080/livez', timeout=2)"]

CMD ["edge-service", "serve"]

ARG VERSION=0.1.0
ARG REVISION=unknown
LABEL org.opencontainers.image.title="aerial-contact" \
      org.opencontainers.image.description="Edge vision and a safety filter for drones that touch things: service and drone" \
      org.opencontainers.image.licenses="Apache-2.0" \
      org.opencontainers.image.version="${VERSION}" \
      org.opencontainers.image.revision="${REVISION}"
