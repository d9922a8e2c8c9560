#!/usr/bin/env python3
"""The rate that a model reaches live: encoder and predictor in one process, and the bundled bag at its real rate.

usage: benches/large_model.py MODEL [--horizon N] [--rate R] [--runs N] [--domain D] [--wm PATH]

MODEL is a folder with the action space of the bundled bag. It may have random weights (`cargo run --release -p wm_zoo --example
random_weights`): they cost the same time. Prints predictions per second, and as a Markdown table the time of encoding, of the
rollout's first step, and from the capture to that step (p50/p95/p99). `--rate R` plays the bag R times as fast. Needs `cargo build
--release`, nothing else.
"""

import argparse
import collections
import datetime
import os
import pathlib
import statistics
import subprocess
import tempfile

from frame import RECORD
from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
LAUNCH = """
launch:
- node:
    pkg: wm_nodes
    exec: wm
    args: "run encoder predictor"
    output: screen
    on_exit: shutdown
    ros_args: "--log-level wm_ros.frame_trace:=debug"
    param:
    - {{name: model, value: "{model}", type: str}}
    - {{name: horizon, value: {horizon}}}
- node:
    pkg: wm_nodes
    exec: player
    name: player
    output: screen
    on_exit: shutdown
    param:
    - from: "{root}/launch-configs/config/jobs.yaml"
    - {{name: bag, value: "{root}/bags/tabletop", type: str}}
    - {{name: rate, value: {rate}}}
    - {{name: wait_for, value: [/wm/action, /wm/latent, /wm/predicted]}}
"""
# From a stage to another, with the step of the rollout; None: the capture.
PARTS = {
    "encoding": (("encoding begun", 0), ("latent computed", 0)),
    "first step": (("rollout begun", 0), ("step computed", 1)),
    "capture to the published first step": (None, ("step published", 1)),
}


def trace(arguments):
    """When each frame, by its stamp, passed each stage [ns]."""
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    with tempfile.NamedTemporaryFile("w", suffix=".launch.yaml") as launch:
        folder = pathlib.Path(arguments.model)
        model = folder.resolve() if folder.is_dir() else arguments.model
        launch.write(LAUNCH.format(model=model, horizon=arguments.horizon, rate=float(arguments.rate), root=ROOT))
        launch.flush()
        command = [arguments.wm, "launch", launch.name]
        run = subprocess.run(command, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    if run.returncode != 0:
        raise SystemExit(run.stdout)
    frames = collections.defaultdict(dict)
    for line in run.stdout.splitlines():
        if found := RECORD.search(line):
            frames[int(found[2])].setdefault((found[1], int(found[3])), int(found[4]))
    return frames


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model")
    parser.add_argument("--horizon", type=int, default=1)
    parser.add_argument("--rate", type=float, default=1.0)
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    arguments = parser.parse_args()

    runs = [trace(arguments) for _ in range(arguments.runs)]
    rates = []
    end = PARTS["first step"][1]
    if any(sum(end in stages for stages in frames.values()) < 2 for frames in runs):
        raise SystemExit("fewer than two predictions in a run: play slower, with --rate")
    for frames in runs:
        published = sorted(stages[end] for stages in frames.values() if end in stages)
        rates.append((len(published) - 1) / (published[-1] - published[0]) * 1e9)
    seen = sum(len(frames) for frames in runs)
    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {arguments.model}, horizon {arguments.horizon}")
    print(f"{seen} frames of {arguments.runs} runs; predictions per second in each: " + ", ".join(f"{r:.1f}" for r in rates) + "\n")
    print("| part | n | p50 ms | p95 ms | p99 ms |")
    print("|---|---|---|---|---|")
    for part, (begin, end) in PARTS.items():
        times = [
            (stages[end] - (stages[begin] if begin else frame)) / 1e6
            for frames in runs
            for frame, stages in frames.items()
            if end in stages and (begin is None or begin in stages)
        ]
        cuts = statistics.quantiles(times, n=100, method="inclusive")
        print(f"| {part} | {len(times)} | " + " | ".join(f"{cuts[p - 1]:.0f}" for p in (50, 95, 99)) + " |")


if __name__ == "__main__":
    main()
