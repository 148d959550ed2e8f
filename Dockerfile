# docker build -t meshsplatbench .
# docker run --rm -v "$PWD:/work" meshsplatbench msb-audit mesh.ply
# Any Debian or Ubuntu with Python 3.11 or newer and its venv module will do: --build-arg BASE=...
ARG BASE=docker.io/library/python:3.12-slim
FROM ${BASE} AS build
COPY . /source
# The wheel of PoCL links kernels with a compiler's libraries, which no slim image has; Debian's PoCL brings what it needs.
RUN python3 -m venv /opt/msb \
 && /opt/msb/bin/pip install --no-cache-dir --quiet /source \
 && /opt/msb/bin/pip uninstall --quiet --yes pocl-binary-distribution

FROM ${BASE}
LABEL org.opencontainers.image.title="MeshSplatBench" org.opencontainers.image.licenses="MIT"
RUN apt-get -qq update \
 && apt-get -qq install --yes --no-install-recommends pocl-opencl-icd \
 && rm -rf /var/lib/apt/lists/* \
 && mkdir -m 1777 /work
COPY --from=build /opt/msb /opt/msb
# Caches are writable for a user of any number, as docker run --user gives.
ENV PATH=/opt/msb/bin:$PATH PYTHONDONTWRITEBYTECODE=1 HOME=/tmp XDG_CACHE_HOME=/tmp/cache POCL_CACHE_DIR=/tmp/pocl
USER 1000:1000
WORKDIR /work
CMD ["msb", "--help"]
