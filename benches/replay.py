#!/usr/bin/env python3
"""The end-to-end benchmark: the four nodes idle, then the main job at the bag's real rate, alternately with one process per
node and with one for all four.

usage: benches/replay.py [--device cuda] [--watched] [--runs N] [--idle-seconds S] [--domain D] [--wm PATH]

Prints Markdown tables: machine, date, n; camera stamp to prediction per step (p50/p95/p99), drops by reason; CPU and
resident memory of each process, idle and at work. The job always records. With --watched, a client receives the pictures of the
node view too, from the fourth second on, but does not draw them. Needs `cargo build --release` and Linux's /proc, nothing else.
"""

import argparse
import datetime
import json
import os
import pathlib
import signal
import socket
import subprocess
import tempfile
import threading
import time

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
NODES = ["encoder", "predictor", "decoder", "planner"]
# The subcommand that runs them in one process.
TOGETHER = "run"
TICKS = os.sysconf("SC_CLK_TCK")


def cpu_seconds(pid):
    fields = pathlib.Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def resident_mib(pid):
    for line in pathlib.Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS"):
            return int(line.split()[1]) / 1024
    return float("nan")


def children(pid):
    """The processes that `pid` started, by the subcommand of `wm` that they run."""
    found = {}
    for entry in pathlib.Path("/proc").iterdir():
        if not entry.name.isdigit():
            continue
        try:
            parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            command = (entry / "cmdline").read_bytes().split(b"\0")
        except (OSError, IndexError):
            continue
        if parent == pid and len(command) > 1:
            found[command[1].decode()] = int(entry.name)
    return found


def usage(pids, seconds):
    before = {name: cpu_seconds(pid) for name, pid in pids.items()}
    start = time.monotonic()
    time.sleep(seconds)
    elapsed = time.monotonic() - start
    return {
        name: (100 * (cpu_seconds(pid) - before[name]) / elapsed, resident_mib(pid))
        for name, pid in pids.items()
    }


def idle(wm, env, seconds, device):
    found, place = {}, ["--ros-args", "-p", f"device:={device}"]
    for commands in ({name: [name] for name in NODES}, {TOGETHER: [TOGETHER, *NODES]}):
        started = {
            name: subprocess.Popen([wm, *command, *place], env=env, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
            for name, command in commands.items()
        }
        time.sleep(5)  # loading the weights and discovery are not idling
        try:
            found |= usage({name: process.pid for name, process in started.items()}, seconds)
        finally:
            for process in started.values():
                process.send_signal(signal.SIGINT)
            for process in started.values():
                process.wait(timeout=10)
    return found


def free_port():
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return listener.getsockname()[1]


def watch(port, received):
    """A client of the node view that receives until the node ends; adds the bytes to `received`."""
    with socket.create_connection(("127.0.0.1", port)) as client:
        client.sendall(
            f"GET /socket HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: Upgrade\r\nUpgrade: websocket\r\n"
            "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\n"
            "Sec-WebSocket-Protocol: wm.view.v1\r\n\r\n".encode()
        )
        while chunk := client.recv(1 << 16):
            received.append(len(chunk))


def replay(wm, env, out, one_process, device, watched):
    port = free_port()
    launch = subprocess.Popen(
        [
            wm,
            "launch",
            str(ROOT / "launch-configs/replay.launch.yaml"),
            f"output:={out}",
            f"device:={device}",
            f"one_process:={str(one_process).lower()}",
            *(["view:=true", f"view_port:={port}"] if watched else []),
        ],
        cwd=ROOT,
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    time.sleep(4)
    received = []
    if watched:
        threading.Thread(target=watch, args=(port, received)).start()
    pids = {name: pid for name, pid in children(launch.pid).items() if name in (*NODES, TOGETHER)}
    work = usage(pids, 4)
    if launch.wait(timeout=120) != 0:
        raise SystemExit(f"the replay ended with {launch.returncode}")
    if watched and sum(received) < 100_000:
        raise SystemExit(f"the client of the node view received {sum(received)} bytes")
    return json.loads((out / "report.json").read_text()), work


def print_latencies(reports):
    print("| step k | n | capture to received: p50 ms | p95 ms | p99 ms |")
    print("|---|---|---|---|---|")
    for index, _ in enumerate(reports[0]["steps"]):
        latencies = [report["steps"][index]["received_latency"] for report in reports]
        # The worst of the runs for each quantile.
        worst = [max(latency[q] for latency in latencies) for q in ("p50_ms", "p95_ms", "p99_ms")]
        n = sum(latency["n"] for latency in latencies)
        print(f"| {index + 1} | {n} | " + " | ".join(f"{value:.1f}" for value in worst) + " |")
    print("\ndrops in each run:", [report["drops"] for report in reports], "\n")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--device", default="cpu", help="device of the model: cpu, cuda or cuda:N")
    parser.add_argument("--watched", action="store_true", help="with the node view and a client")
    parser.add_argument("--runs", type=int, default=5)
    parser.add_argument("--idle-seconds", type=float, default=20)
    parser.add_argument("--domain", type=int, default=99)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    arguments = parser.parse_args()
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

    about = f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {arguments.runs} runs of the bundled bag, device {arguments.device}"
    print(about + (", watched\n" if arguments.watched else "\n"))
    resting = idle(arguments.wm, env, arguments.idle_seconds, arguments.device)
    reports, work = {False: [], True: []}, {}
    with tempfile.TemporaryDirectory() as directory:
        for run in range(arguments.runs):
            for one_process, of_kind in reports.items():
                out = pathlib.Path(directory) / f"{run}-{one_process}"
                report, usages = replay(arguments.wm, env, out, one_process, arguments.device, arguments.watched)
                of_kind.append(report)
                work |= usages

    for one_process, of_kind in reports.items():
        print("One process for all four nodes:\n" if one_process else "A process a node:\n")
        print_latencies(of_kind)
    print("| process | idle CPU % | idle MiB | at work CPU % | at work MiB |")
    print("|---|---|---|---|---|")
    for name in (*NODES, TOGETHER):
        at_work = work.get(name, (float("nan"), float("nan")))
        print(f"| {name} | {resting[name][0]:.1f} | {resting[name][1]:.0f} | {at_work[0]:.0f} | {at_work[1]:.0f} |")


if __name__ == "__main__":
    main()
