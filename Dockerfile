# kinebench-drake as a program:
#
#   docker build -t kinebench-drake .                                                                  # CPU
#   docker build -t kinebench-drake --build-arg TORCH=https://download.pytorch.org/whl/cu128 .         # NVIDIA GPU
#   docker run --rm -v "$PWD:/data" -u "$(id -u)" kinebench-drake score videos --out results           # GPU: --gpus all
FROM debian:bookworm-slim

# Index of the build of PyTorch.
ARG TORCH=https://download.pytorch.org/whl/cpu

RUN apt-get update && apt-get install -y --no-install-recommends ca-certificates python3 python3-venv
COPY . /opt/kinebench-drake
RUN PIP_NO_CACHE_DIR=1 PIP_EXTRA_INDEX_URL="$TORCH" /opt/kinebench-drake/setup/install.sh
RUN useradd --create-home kinebench && mkdir -m 777 /cache

# Converted models and fonts; writable for any user that `docker run -u` names.
ENV HOME=/cache NVIDIA_DRIVER_CAPABILITIES=all
USER kinebench
WORKDIR /data
ENTRYPOINT ["/opt/kinebench-drake/.venv/bin/kinebench-drake"]
CMD ["--help"]
