# docker build -t racines .                              --build-arg EXTRAS=all for every extra
# docker run --rm racines                                what is here: racines doctor
# docker run --rm -v "$PWD:/work" racines demo           writes demo/ into the current folder
# A torch without CUDA: --build-arg PIP_EXTRA_INDEX_URL=the index of PyTorch's CPU builds.

# For work on a clone, which is mounted: make sets up its .venv there (.devcontainer/).
FROM python:3.11 AS dev
RUN useradd --create-home developer
USER developer
CMD ["bash"]

FROM python:3.11-slim AS racines
ARG EXTRAS=train,explain,onnx,import
ARG PIP_EXTRA_INDEX_URL
COPY pyproject.toml hatch_build.py README.md LICENSE constraints.txt /src/
COPY racines_data /src/racines_data
COPY models /src/models
COPY envs /src/envs
COPY leaderboard /src/leaderboard
RUN pip install --no-cache-dir -c /src/constraints.txt "/src[${EXTRAS}]" && rm -r /src
RUN useradd --create-home scientist && mkdir /work && chown scientist /work
USER scientist
WORKDIR /work
ENTRYPOINT ["racines"]
CMD ["doctor"]
