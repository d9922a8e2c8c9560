# wm in a container: the program, the launch files and the bundled bag, run by a user without rights.
#
#   docker build -t wm .
#   docker run --rm -it --network host --read-only --tmpfs /tmp --cap-drop ALL --security-opt no-new-privileges \
#       --memory 4g --volume wm-out:/var/lib/wm wm launch live.launch.yaml
#
# With the host's network, and its loopback by default: DDS participants of one host find each other there, and the socket
# filter of wm drops what comes from other machines (docs/security.md). `--network none` does for a replay.

FROM rust:1.95-slim-bookworm AS build
# For the C code of zstd and lz4.
RUN apt-get update && apt-get install --yes --no-install-recommends build-essential && rm -rf /var/lib/apt/lists/*
WORKDIR /wm
COPY . .
RUN cargo build --release --locked --package wm_cli

FROM debian:bookworm-slim
RUN useradd --uid 10001 --home-dir /var/lib/wm --create-home wm
COPY --from=build /wm/target/release/wm /usr/bin/wm
# launch/ and bags/ lie beside each other as launch-configs/ and bags/ do in the repository.
COPY launch-configs/ /usr/share/wm/launch/
COPY bags/tabletop/ /usr/share/wm/bags/tabletop/
COPY LICENSE-APACHE LICENSE-MIT /usr/share/doc/wm/
USER wm
WORKDIR /var/lib/wm
ENTRYPOINT ["wm"]
CMD ["launch", "replay.launch.yaml"]
