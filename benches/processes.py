#!/usr/bin/env python3
"""Training steps of `wm train transition` in several processes of this machine against one process.

usage: benches/processes.py [--rounds N] [--steps N] [--no-build] [--set PATH=VALUE ...]

Builds wm-training, makes a few simulated bags, and trains the bundled default's transition model in turns, round by
round: in one process with one thread, in one with two threads, and in two with one thread each, connected by the
loopback interface. It prints the median and p95 of all steps, and the median and range of the rounds' speeds relative
to one thread. They need an idle machine with a core for each process. On a busy one, the CPU time is more exact: a
step's in each process, and by how much less the busiest one needs than the only one of the first row. That ratio is
the speed with a core for each process, if nothing waits.

All trainings must write the same weights. For a network of 1 Gbit/s in both directions together, run it as root after
unshare -n, ip link set lo up, and tc qdisc replace dev lo root tbf rate 1gbit burst 256kb latency 50ms.
"""

import argparse
import datetime
import hashlib
import os
import pathlib
import statistics
import subprocess
import tempfile

from events import step_times
from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
BINARY = ROOT / "target/release/wm-training"
# Skipped steps: the first ones fill caches, and a worker computes a trial batch.
WARM = 4
# Name, threads of each process, workers.
WAYS = [("1 process, 1 thread", 1, 0), ("1 process, 2 threads", 2, 0), ("2 processes, 1 thread each", 1, 1)]


def start(command, output):
    # A session each: Linux divides a busy machine's time among sessions, as among machines.
    return subprocess.Popen(command, stdout=output, stderr=subprocess.DEVNULL, text=True, start_new_session=True)


def train(out, bags, settings, steps, threads, workers):
    """CPU time of each process (s)."""
    data = ["--data", bags, "--encoder", "tiny", "--cache", bags.parent / "cache", "--validation", "0"]
    data += ["--threads", str(threads)]
    command = [BINARY, "train", "transition", *data, "--out", out, "--steps", str(steps)]
    command += ["--set", "validate_every=100000", *(word for setting in settings for word in ("--set", setting))]
    if workers:
        command += ["--listen", "127.0.0.1:0", "--workers", str(workers)]
    processes = [start(command, subprocess.PIPE)]
    for line in processes[0].stdout:
        if line.startswith("listening for workers on "):
            worker = [BINARY, "train", "worker", line.split()[4].rstrip(","), *data]
            processes += [start(worker, subprocess.DEVNULL) for _ in range(workers)]
    ended = [os.wait4(process.pid, 0) for process in processes]
    assert all(status == 0 for _, status, _ in ended)
    return [usage.ru_utime + usage.ru_stime for *_, usage in ended]


def measure(bags, settings, steps, threads, workers):
    """Times of the steps (ms), CPU time of a step in each process (s), and the digest of the weights."""
    with tempfile.TemporaryDirectory() as folder:
        starts = train(pathlib.Path(folder, "start"), bags, settings, WARM, threads, workers)
        out = pathlib.Path(folder, "out")
        # One more step, which ends with a validation and is skipped.
        whole = train(out, bags, settings, WARM + steps + 1, threads, workers)
        (events,) = out.rglob("events.out.tfevents.*")
        digest = hashlib.sha256((out / "transition.safetensors").read_bytes()).hexdigest()
        used = [(b - a) / (steps + 1) for a, b in zip(starts, whole)]
        return step_times(events)[WARM - 1 :][:steps], used, digest


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--steps", type=int, default=20, help="measured steps of each training, at most 120")
    parser.add_argument("--no-build", action="store_true")
    parser.add_argument("--set", action="append", default=[], metavar="PATH=VALUE", help="setting of the recipe")
    arguments = parser.parse_args()
    if not arguments.no_build:
        subprocess.run(["cargo", "build", "--release", "-p", "wm_training"], cwd=ROOT, check=True)
    times, speeds, used, less = ({name: [] for name, *_ in WAYS} for _ in range(4))
    digests, alone = set(), WAYS[0][0]
    with tempfile.TemporaryDirectory() as scratch:
        bags = pathlib.Path(scratch, "bags")
        make = [BINARY, "sim", "--episodes", "8", "--seed", "0", "--frames", "50", "--out", bags]
        subprocess.run(make, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        for _ in range(arguments.rounds):
            medians = {}
            for name, threads, workers in WAYS:
                found, cpu, digest = measure(bags, arguments.set, arguments.steps, threads, workers)
                times[name] += found
                used[name].append(cpu)
                medians[name] = statistics.median(found)
                digests.add(digest)
            for name, _, _ in WAYS:
                speeds[name].append(medians[alone] / medians[name])
                less[name].append(used[alone][-1][0] / max(used[name][-1]))
    assert len(digests) == 1, "the weights differ"
    cores = len(os.sched_getaffinity(0))
    print(f"{processor()}, {cores} cores, {datetime.date.today()}, {arguments.rounds} x {arguments.steps} steps\n")
    print("| | ms per step, p50 (p95) | speed | CPU s per step and process | by CPU time |\n|---|---|---|---|---|")
    ratio = lambda values: f"{statistics.median(values):.2f} ({min(values):.2f} to {max(values):.2f})"
    for name, threads, _ in WAYS:
        found = times[name]
        cell = f"{statistics.median(found):.0f} ({statistics.quantiles(found, n=20)[-1]:.0f})"
        cpu = ", ".join(f"{statistics.median(process):.2f}" for process in zip(*used[name]))
        # Threads divide the time of their process.
        by_time = ratio(less[name]) if threads == 1 else "-"
        print(f"| {name} | {cell} | {ratio(speeds[name])} | {cpu} | {by_time} |")
    print(f"\nall {len(WAYS) * arguments.rounds} trainings wrote the same weights, sha256 {digests.pop()[:16]}")


if __name__ == "__main__":
    main()
