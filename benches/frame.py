#!/usr/bin/env python3
"""Where the time of one camera frame goes: the main job at the bag's real rate; every node logs the time of each frame at
each stage.

usage: benches/frame.py [--runs N] [--domain D] [--wm PATH]

Prints a Markdown table for one process per node and one for one process for all: for each stage the time since the
previous stage and since the capture (p50/p95). Needs `cargo build --release`, nothing else.
"""

import argparse
import collections
import datetime
import os
import pathlib
import re
import statistics
import subprocess
import tempfile

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECORD = re.compile(r"\]: ([a-z ]+) frame=(\d+) step=(\d+) at=(\d+)\s*$")
# The stages in their order, by the nodes' names for them, and their descriptions.
TO_THE_ROLLOUT = [
    ("image due", "player: timer, reading ahead, new stamp"),
    ("image published", "player: DDS write"),
    ("image received", "DDS: player to encoder"),
    ("image taken", "encoder: wake-up of its loop, CDR"),
    ("picture decoded", "encoder: hand-over to a thread, JPEG"),
    ("encoding begun", "encoder: whether the picture has changed, hand-over to its thread"),
    ("picture resized", "encoder: resize, to f32"),
    ("latent computed", "encoder: the network"),
    ("latent taken", "encoder: f16, back to the loop"),
    ("latent published", "encoder: CDR, DDS write"),
    ("observation received", "DDS: encoder to predictor"),
    ("observation taken", "predictor: wake-up of its loop, CDR, history, request"),
    ("rollout begun", "predictor: hand-over to its thread"),
]
OF_A_STEP = [
    ("step computed", "predictor: {}"),
    ("step published", "predictor: f16, CDR, DDS write of {}"),
    ("step received", "DDS: {} to monitor"),
]


def trace(wm, env, one_process):
    """Of each frame, by its stamp: the time of each stage of each step [ns]."""
    with tempfile.TemporaryDirectory() as out:
        run = subprocess.run(
            [
                wm,
                "launch",
                str(ROOT / "launch-configs/replay.launch.yaml"),
                f"output:={out}",
                f"one_process:={str(one_process).lower()}",
                "log_level:=wm_ros.frame_trace:=debug",
            ],
            cwd=ROOT,
            env=env,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=True,
        )
    frames = collections.defaultdict(dict)
    for line in run.stdout.splitlines():
        if found := RECORD.search(line):
            stage, frame, step, at = found[1], int(found[2]), int(found[3]), int(found[4])
            frames[frame].setdefault((stage, step), at)
    return frames


def print_table(frames):
    """Of frames with a complete rollout: the duration of each stage, from the end of the previous one, and when it was
    over; of the steps after the first how long each took, and when the last was over."""
    horizon = max((step for stamps in frames.values() for _, step in stamps), default=0)
    whole = {frame: stamps for frame, stamps in frames.items() if ("step received", horizon) in stamps}
    stages = [(stage, 0, text) for stage, text in TO_THE_ROLLOUT]
    for step in range(1, horizon + 1):
        which = "step 1" if step == 1 else f"each of steps 2 to {horizon}"
        stages += [(stage, step, text.format(which)) for stage, text in OF_A_STEP]
    before = {frame: frame for frame in whole}
    took, since = collections.defaultdict(list), {}
    for stage, step, text in stages:
        passed = {frame: stamps[(stage, step)] for frame, stamps in whole.items() if (stage, step) in stamps}
        took[text] += [(at - before[frame]) / 1e6 for frame, at in passed.items()]
        since[text] = [(at - frame) / 1e6 for frame, at in passed.items()]
        # The next step does not wait until this one has arrived.
        if stage != "step received":
            before |= passed
    print(f"n = {len(whole)} frames\n")
    print("| stage | p50 ms | p95 ms | since the capture: p50 ms | p95 ms |")
    print("|---|---|---|---|---|")
    for text, times in took.items():
        if len(times) > 1:
            cells = [value for column in (times, since[text]) for value in (statistics.median(column), p95(column))]
            print(f"| {text} | " + " | ".join(f"{cell:.2f}" for cell in cells) + " |")
    print()


def p95(values):
    return statistics.quantiles(values, n=20, method="inclusive")[18]


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=3)
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    arguments = parser.parse_args()
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {arguments.runs} runs of the bundled bag\n")
    frames = {False: {}, True: {}}
    for _ in range(arguments.runs):
        for one_process, of_kind in frames.items():
            of_kind |= trace(arguments.wm, env, one_process)
    for one_process, of_kind in frames.items():
        print("One process for all four nodes:" if one_process else "A process a node:", end=" ")
        print_table(of_kind)


if __name__ == "__main__":
    main()
