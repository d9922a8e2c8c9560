#!/usr/bin/env python3
"""Flame graphs of one camera frame (encoder and predictor) and of one plan (planner): the main job under `perf`, with the
time of each function divided by the number of frames, or plans.

usage: benches/flame.py [--out FOLDER] [--domain D] [--wm PATH]

Writes FOLDER/frame.svg and FOLDER/plan.svg (docs/ by default). Needs `cargo build --release` and Linux's perf, as root or
with kernel.perf_event_paranoid at 1 or below. Inlined functions count for their callers.
"""

import argparse
import collections
import datetime
import html
import json
import os
import pathlib
import re
import subprocess
import tempfile
import time

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
# Samples a second, no divisor of anything that happens periodically.
RATE = 997
SAMPLE = re.compile(r"^(\S.*?)\s+(\d+)\s+[\d.]+:\s")
FRAME = re.compile(r"^\s+[0-9a-f]+ (.+) \(([^)]*)\)$")
WIDTH, ROW, LEAST_WIDTH = 1200, 17, 0.4
COLOURS = {"model": "#f28e2b", "image": "#59a14f", "nodes": "#4e79a7", "dds": "#b07aa1", "system": "#bab0ac"}


def record(wm, env, out, data):
    launch = subprocess.Popen(
        [wm, "launch", str(ROOT / "launch-configs/replay.launch.yaml"), f"output:={out}"],
        cwd=ROOT,
        env=env,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    time.sleep(2)  # the processes start at once, and load the model before the first frame
    pids = nodes_of(launch.pid)
    command = ["perf", "record", "--quiet", "--event", "cpu-clock", "--freq", str(RATE), "--call-graph", "dwarf,40960"]
    command += ["--output", str(data), "--pid", ",".join(str(pid) for pid in pids)]
    perf = subprocess.Popen(command)
    if launch.wait(timeout=120) != 0:
        raise SystemExit(f"the replay ended with {launch.returncode}")
    perf.wait(timeout=60)
    return pids


def nodes_of(parent):
    """The processes of the nodes that are shown, with their names."""
    found = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                status = (entry / "stat").read_text().rsplit(")", 1)[1].split()
                command = (entry / "cmdline").read_bytes().split(b"\0")
            except (OSError, IndexError):
                continue
            if int(status[1]) == parent and len(command) > 1:
                name = command[1].decode()
                if name in ("encoder", "predictor", "planner"):
                    found[int(entry.name)] = name
    return found


def stacks(data, pids):
    """Samples by stack, outermost function first; the first is the node."""
    script = subprocess.Popen(
        ["perf", "script", "--input", str(data), "--no-inline", "--fields", "comm,pid,time,ip,sym,dso"],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    found, node, frames = collections.Counter(), None, []
    for line in script.stdout:
        if sample := SAMPLE.match(line):
            node, frames = pids.get(int(sample[2])), []
        elif frame := FRAME.match(line):
            frames.append(readable(frame[1]))
        elif not line.strip() and node and frames:
            found[(node, *outermost_first(frames))] += 1
    return found


def readable(symbol):
    symbol = re.sub(r"\+0x[0-9a-f]+$", "", symbol)
    symbol = re.sub(r"::h[0-9a-f]{16}$|\{\{vtable.shim\}\}|\{\{closure\}\}", "", symbol)
    return re.sub(r"(::)+$", "", symbol)


def outermost_first(frames):
    """Without functions that only carry a job to its thread, and without repetitions."""
    carriers = ("std::", "core::", "rayon", "tokio::", "tracing::", "alloc::", "<core::", "<alloc::", "<rayon", "<std::")
    carriers += ("<tokio::", "__rust", "[unknown]", "start_thread", "__clone", "clone3", "_start", "__libc_start", "main")
    kept = []
    for frame in reversed(frames):
        # A node's jobs are closures of its `activate`.
        is_carrier = frame.startswith(carriers) or frame.endswith("::activate")
        if not is_carrier and (not kept or kept[-1] != frame):
            kept.append(frame)
    return kept or [frames[0]]


def colour(name):
    kinds = [
        ("model", "wm_model::|wm_planner|wm_zoo|candle|rand"),
        ("image", "image|zune|jpeg|fast_image|wm_camera"),
        ("dds", "rustdds|cdr|speedy|wm_msgs"),
        ("nodes", "wm_|encoder|predictor|planner"),
    ]
    return COLOURS[next((kind for kind, names in kinds if re.search(names, name)), "system")]


def draw(found, samples_per_ms, title, path):
    """Boxes from below, as wide as their share; `title` has the whole."""
    tree = lambda: {"count": 0, "inner": collections.defaultdict(tree)}
    root = tree()
    for stack, count in found.items():
        root["count"] += count
        at = root
        for frame in stack:
            at = at["inner"][frame]
            at["count"] += count
    if not root["count"]:
        raise SystemExit(f"perf has no samples for {path}")
    scale = WIDTH / root["count"]
    boxes = []

    def place(at, x, depth):
        for name, inner in sorted(at["inner"].items(), key=lambda item: -item[1]["count"]):
            if inner["count"] * scale >= LEAST_WIDTH:
                boxes.append((name, x, depth, inner["count"]))
                place(inner, x, depth + 1)
            x += inner["count"] * scale

    place(root, 0.0, 0)
    height = (max(depth for _, _, depth, _ in boxes) + 1) * ROW + 30
    svg = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{WIDTH}" height="{height}" font-family="monospace" font-size="11">',
        f'<rect width="{WIDTH}" height="{height}" fill="white"/><text x="4" y="16" font-size="13">{html.escape(title)}</text>',
    ]
    for name, x, depth, count in boxes:
        y, width = height - (depth + 1) * ROW, count * scale
        text = f"{name} ({count / samples_per_ms:.2f} ms, {100 * count / root['count']:.1f} %)"
        svg.append(f"<g><title>{html.escape(text)}</title>")
        svg.append(
            f'<rect x="{x:.1f}" y="{y}" width="{max(width - 0.3, 0.2):.1f}" height="{ROW - 1}" fill="{colour(name)}"/>'
        )
        letters = int(width / 6.7)
        if letters >= 4:
            # The end of a path says most.
            short = text if len(text) <= letters else name if len(name) <= letters else name.rsplit("::", 1)[-1][:letters]
            svg.append(f'<text x="{x + 2:.1f}" y="{y + 12}">{html.escape(short)}</text>')
        svg.append("</g>")
    path.write_text("\n".join([*svg, "</svg>", ""]))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "docs")
    parser.add_argument("--domain", type=int, default=94)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")
    with tempfile.TemporaryDirectory() as directory:
        out, data = pathlib.Path(directory) / "out", pathlib.Path(directory) / "perf.data"
        pids = record(arguments.wm, env, out, data)
        report = json.loads((out / "report.json").read_text())
        found = stacks(data, pids)
    machine = f"{processor()}, {datetime.date.today()}"
    frames, plans = report["frames"], report["plans"]["plans"]
    for name, nodes, what, number in [
        ("frame", ("encoder", "predictor"), "a frame: encoder and predictor", frames),
        ("plan", ("planner",), "a plan: planner", plans),
    ]:
        of_nodes = {stack: count for stack, count in found.items() if stack[0] in nodes}
        samples_per_ms = RATE * number / 1000
        whole = sum(of_nodes.values()) / samples_per_ms
        title = f"{what}, {whole:.1f} ms of processor time, mean of {number} ({machine})"
        draw(of_nodes, samples_per_ms, title, arguments.out / f"{name}.svg")


main()
