# docker build -t meshsplatbench .
# docker run --rm -v "$PWD:/work" meshsplatbench msb-audit mesh.ply
# Any Debian or Ubuntu with Python 3.11 or newer and its venv module will do: --build-arg BASE=...
ARG BASE=docker.io/library/python:3.12-slim
FROM ${BASE} AS build
COPY . /source
RUN python3 -m venv /opt/msb && /opt/msb/bin/pip install --no-cache-dir --quiet /source

FROM ${BASE}
LABEL org.opencontainers.image.title="MeshSplatBench" org.opencontainers.image.licenses="MIT"
COPY --from=build /opt/msb /opt/msb
# PoCL came with it (x86-64). Its cache and ours must be writable for a user whose number is given with --user.
ENV PATH=/opt/msb/bin:$PATH PYTHONDONTWRITEBYTECODE=1 HOME=/tmp XDG_CACHE_HOME=/tmp/cache POCL_CACHE_DIR=/tmp/pocl
RUN mkdir -m 1777 /work
USER 1000:1000
WORKDIR /work
CMD ["msb", "--help"]
