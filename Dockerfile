# The command `zeroshop` in a container (docs/package.md): stage `cpu`, or `cuda` for a card with CUDA 13, whose libraries come in wheels.
FROM python:3.11-slim-bookworm AS wheel
WORKDIR /source
RUN pip install --no-cache-dir hatchling==1.29.0
COPY pyproject.toml README.md LICENSE requirements.lock requirements-gpu.lock ./
COPY config config
COPY docs docs
COPY workflow workflow
COPY src src
RUN pip wheel --no-cache-dir --no-deps --no-build-isolation --wheel-dir /wheels .

FROM python:3.11-slim-bookworm AS cpu
# Open3D and PyMeshLab link them (zeroshop_steps.runtime.check_install); their versions are the base image's.
# hadolint ignore=DL3008
RUN apt-get update \
    && apt-get install --yes --no-install-recommends libegl1 libgl1 libgomp1 libopengl0 libudev1 libx11-6 \
    && rm -rf /var/lib/apt/lists/*
# PyTorch's index of CPU builds, given by --build-arg, saves several GB.
ARG PIP_EXTRA_INDEX_URL=
COPY --from=wheel /source/requirements.lock /source/requirements-gpu.lock /locks/
COPY --from=wheel /wheels /wheels
# torch first and alone: together with other packages, pip may choose another build of it.
RUN pip install --no-cache-dir "$(grep '^torch==' /locks/requirements.lock)" \
    && pip install --no-cache-dir --constraint /locks/requirements.lock "$(echo /wheels/*.whl)[robot]" \
    && python -m zeroshop_steps.runtime.check_install
# Any user may run it: weights and compiled kernels go to a folder of everybody's, results below the mounted one.
ENV HOME=/cache XDG_CACHE_HOME=/cache NUMBA_CACHE_DIR=/cache/numba
RUN mkdir --mode=1777 /cache
WORKDIR /data
ENTRYPOINT ["zeroshop"]

FROM cpu AS cuda
# onnxruntime and onnxruntime-gpu are one module by two names: the second one takes the place of the first.
RUN pip uninstall --yes onnxruntime && pip install --no-cache-dir --requirement /locks/requirements-gpu.lock
ENV NVIDIA_VISIBLE_DEVICES=all NVIDIA_DRIVER_CAPABILITIES=compute,utility

# Without --target, the stage without CUDA.
FROM cpu
