# up_samp with compiled motion kernels: the first plan does not wait for a compiler.
#
#   docker build -t up-samp .
#   docker run --rm -v "$PWD/out:/out" up-samp demo --out /out
FROM python:3.12-slim

# machine code for any x86-64 (or arm64) processor, not for the one that builds the image
ENV NUMBA_CPU_NAME=generic \
    UP_SAMP_CACHE_DIR=/opt/up-samp-cache \
    PYTHONDONTWRITEBYTECODE=1 \
    MPLCONFIGDIR=/tmp

WORKDIR /src
COPY pyproject.toml setup.py README.md LICENSE ./
COPY up_samp ./up_samp
RUN pip install --no-cache-dir . && cd / && rm -rf /src && up-samp warmup

RUN useradd --create-home planner
USER planner
WORKDIR /home/planner
ENTRYPOINT ["up-samp"]
CMD ["--help"]
