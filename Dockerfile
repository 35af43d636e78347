# The commands of docs/install.md and README.md on a slim Debian; then any kneexo command:
#   docker build -t kneexo .
#   docker run --rm -v "$PWD/results:/results" kneexo reproduce --out /results
FROM debian:bookworm-slim
RUN apt-get update && apt-get install -y python3-venv libglib2.0-0
WORKDIR /kneexo
COPY . .
RUN python3 -m kneexo.system && python3 -m venv .venv && .venv/bin/pip install . && .venv/bin/kneexo reproduce --out results
RUN python3 -m kneexo.system && python3 -m venv .venv && .venv/bin/pip install -e ".[dev]" && .venv/bin/python -m pytest
ENTRYPOINT [".venv/bin/kneexo"]
