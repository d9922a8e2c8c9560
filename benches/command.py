#!/usr/bin/env python3
"""From the capture of a frame to the command of the arm: encoder, planner `idm`, executor and the simulated arm as processes,
with and without recorder and page.

usage: benches/command.py [--episodes N] [--middlewares dds zenoh] [--domain D] [--wm PATH]

Prints a Markdown table: of each stage the time since the capture (p50/p95/p99), and the number of frames. The executor sends a
command every 50 ms, so a command waits 25 ms for its turn on average. Needs `cargo build --release`; for Zenoh with
`--features zenoh`, and a free port 7447.
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
STAGES = {
    "latent published": "encoder: latent",
    "plan published": "planner: plan",
    "command published": "executor: first command of the plan",
}
MIDDLEWARES = {"dds": "rmw_fastrtps_cpp", "zenoh": "rmw_zenoh_cpp"}


def trace(arguments, middleware, watched):
    """Of each frame, by its stamp: when it passed each stage [ns]."""
    wanted = "true" if watched else "false"
    env = dict(
        os.environ,
        ROS_DOMAIN_ID=str(arguments.domain),
        ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST",
        RMW_IMPLEMENTATION=MIDDLEWARES[middleware],
    )
    with tempfile.TemporaryDirectory() as out:
        command = [arguments.wm, "launch", str(ROOT / "launch-configs/arm.launch.yaml"), f"output:={out}"]
        command += ["tasks:=[reach, push]", f"episodes:={arguments.episodes}", "planner:=idm"]
        command += [f"record:={wanted}", f"view:={wanted}", "log_level:=wm_ros.frame_trace:=debug"]
        run = subprocess.run(
            command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True
        )
    frames = collections.defaultdict(dict)
    for line in run.stdout.splitlines():
        if found := RECORD.search(line):
            frames[int(found[2])].setdefault(found[1], int(found[4]))
    return frames


def row(frames, stage):
    """The count, and p50, p95 and p99 since the capture [ms]."""
    since = [(stages[stage] - frame) / 1e6 for frame, stages in frames.items() if stage in stages]
    cuts = statistics.quantiles(since, n=100, method="inclusive")
    return len(since), cuts[49], cuts[94], cuts[98]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=5, help="of each task")
    parser.add_argument("--middlewares", nargs="+", choices=MIDDLEWARES, default=["dds"])
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    arguments = parser.parse_args()

    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {arguments.episodes} episodes of reach and push\n")
    print("| middleware | recorder and page | stage | n | p50 ms | p95 ms | p99 ms |")
    print("|---|---|---|---|---|---|---|")
    for middleware in arguments.middlewares:
        for watched in (False, True):
            frames = trace(arguments, middleware, watched)
            for stage, text in STAGES.items():
                count, *times = row(frames, stage)
                cells = [middleware, "on" if watched else "off", text, str(count), *(f"{time:.1f}" for time in times)]
                print("| " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
