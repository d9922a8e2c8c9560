#!/usr/bin/env python3
"""The learner beside the live nodes, on a recorded robot: how long until its models beat the last frame, and what the
training costs the predictions.

usage: benches/learner.py BAG... [--minutes 30] [--alone 3] [--camera T] [--action T] [--action-space FILE]
                          [--domain D] [--wm PATH] --out OUT
       benches/learner.py --draw NAME=OUT... --out FILE.svg

Joins the bags to one recording and plays it in a loop, with the stamps of now: the robot. Beside it runs
launch-configs/live.launch.yaml, first with `learn:=true` for `--minutes`, then for `--alone` minutes with the last model and
without the learner. Prints Markdown:

- the calibrated error ratio one step ahead by minute: the sum of the squared errors over that of the last frame, repeated;
- the minutes until it is below .9 and .7 for good;
- each round of the learner;
- the time from capture to received prediction, with and without the learner.

OUT gets both runs, figures.json and learner.svg: the ratio by minute as a line, and that of each round's model in its test, a
circle if it was accepted and a cross if not. `--draw` draws several runs into one picture. Needs
`cargo build --release -p wm_training` and `cargo build --release`, and of PyPI mcap-ros2-support and matplotlib.
"""

import argparse
import datetime
import json
import os
import pathlib
import signal
import struct
import subprocess

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECORDED = ["/wm/prediction_error", "/wm/learner/status"]
PAUSE_NS = 1_000_000_000  # between two bags: enough for the nodes to begin a new history


def end(process):
    """Ends a process as Ctrl-C does."""
    process.send_signal(signal.SIGINT)
    process.wait(timeout=120)


def join(bags, topics, path):
    """Writes the messages of these topics of all bags into one, each bag after the one before."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start("ros2")
        channels, end = {}, None
        for bag in bags:
            shift = None
            for part in sorted(pathlib.Path(bag).glob("*.mcap")):
                with open(part, "rb") as stream:
                    for schema, channel, message in make_reader(stream).iter_messages(topics=topics):
                        if shift is None:
                            shift = 0 if end is None else end + PAUSE_NS - message.log_time
                        if channel.topic not in channels:
                            known = writer.register_schema(schema.name, schema.encoding, schema.data)
                            channels[channel.topic] = writer.register_channel(
                                channel.topic, channel.message_encoding, known, channel.metadata
                            )
                        # All these messages begin with a header: its stamp follows the CDR encapsulation.
                        seconds, nanoseconds = struct.unpack_from("<iI", message.data, 4)
                        seconds, nanoseconds = divmod(seconds * 10**9 + nanoseconds + shift, 10**9)
                        data = message.data[:4] + struct.pack("<iI", seconds, nanoseconds) + message.data[12:]
                        end = message.log_time + shift
                        writer.add_message(channels[channel.topic], end, data, end)
        writer.finish()


def run(arguments, env, out, minutes, settings):
    """The report of the live nodes after so many minutes."""
    out.mkdir(parents=True)
    launch = [arguments.wm, "launch", str(ROOT / "launch-configs/live.launch.yaml"), f"output:={out / 'live'}"]
    launch += [f"camera:={arguments.camera}", f"action:={arguments.action}", *settings]
    with open(out / "launch.log", "w", encoding="utf-8") as log:
        nodes = subprocess.Popen(launch, env=env, stdout=log, stderr=subprocess.STDOUT)
        recorder = subprocess.Popen(
            [arguments.wm, "bag", "record", "-o", str(out / "recorded"), *RECORDED], env=env, stdout=log, stderr=subprocess.STDOUT
        )
        played = [arguments.wm, "bag", "play", str(arguments.out / "robot.mcap"), "--loop"]
        played += ["--ros-args", "-p", "restamp:=true"]
        player = subprocess.Popen(played, env=env, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT)
        try:
            nodes.wait(timeout=60 * minutes)
            raise SystemExit(f"the nodes ended with {nodes.returncode}: see {out / 'launch.log'}")
        except subprocess.TimeoutExpired:
            pass
        finally:
            end(player)
            end(recorder)
            if nodes.poll() is None:
                end(nodes)
    return json.loads((out / "live/report.json").read_text())


def messages(folder, topic):
    """The messages of a topic with their log times [s]."""
    from mcap_ros2.reader import read_ros2_messages

    for file in sorted(folder.glob("*.mcap")):
        for read in read_ros2_messages(str(file), topics=[topic]):
            yield read.log_time_ns / 1e9, read.ros_msg


def by_minute(errors, start):
    """(minute since `start`, ratio, n) of the errors one step ahead."""
    rows = {}
    for time, mse, persistence in errors:
        row = rows.setdefault(int((time - start) // 60), [0.0, 0.0, 0])
        row[0], row[1], row[2] = row[0] + mse, row[1] + persistence, row[2] + 1
    return [(minute, mse / persistence, n) for minute, (mse, persistence, n) in sorted(rows.items()) if persistence > 0]


def below(ratios, bound):
    """The first minute from which on all ratios are below `bound`."""
    since = None
    for minute, ratio, _ in ratios:
        since = None if ratio >= bound else minute if since is None else since
    return since


def draw(path, runs):
    """Draws the figures of each run, by the name of its robot."""
    import matplotlib

    matplotlib.use("svg")
    from matplotlib import pyplot

    matplotlib.rcParams |= {"svg.hashsalt": "wm", "svg.fonttype": "none"}
    figure, axes = pyplot.subplots(figsize=(7, 3.2), layout="constrained")
    for name, run in runs.items():
        (line,) = axes.plot([minute + 0.5 for minute, *_ in run["ratios"]], [ratio for _, ratio, _ in run["ratios"]], label=name)
        for accepted, mark in ((True, "o"), (False, "x")):
            of_kind = [r for r in run["rounds"] if r["accepted"] == accepted]
            axes.plot([(r["time"] - run["start"]) / 60 for r in of_kind], [r["ratio"] for r in of_kind], mark, color=line.get_color())
    axes.axhline(1, color="grey", linewidth=0.8)
    axes.set(xlabel="minutes", ylabel="squared error one step ahead\n/ that of the last frame", ylim=(0, 1.3))
    axes.legend(frameon=False)
    figure.savefig(path, metadata={"Date": None})


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("bags", nargs="*")
    parser.add_argument("--draw", nargs="+", metavar="NAME=OUT", help="draw these earlier runs instead, into the file --out")
    parser.add_argument("--minutes", type=float, default=30)
    parser.add_argument("--alone", type=float, default=3)
    parser.add_argument("--camera", default="/camera/image_raw")
    parser.add_argument("--action", default="/wm/action")
    parser.add_argument("--action-space")
    parser.add_argument("--domain", type=int, default=98)
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    if arguments.draw:
        runs = dict(run.split("=", 1) for run in arguments.draw)
        draw(arguments.out, {name: json.loads((pathlib.Path(out) / "figures.json").read_text()) for name, out in runs.items()})
        return
    if not arguments.bags:
        parser.error("a bag is missing")
    env = dict(os.environ, ROS_DOMAIN_ID=str(arguments.domain), ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST")

    print(f"{processor()}, {os.cpu_count()} cores, {datetime.date.today()}, {len(arguments.bags)} bags\n", flush=True)
    arguments.out.mkdir(parents=True)
    topics = [arguments.camera, f"{arguments.camera}/compressed", arguments.action]
    join(arguments.bags, topics, arguments.out / "robot.mcap")
    settings = ["learn:=true"]
    if arguments.action_space:
        settings.append(f"action_space:={arguments.action_space}")
    reports = {"learning": run(arguments, env, arguments.out / "learning", arguments.minutes, settings)}
    recorded = arguments.out / "learning/recorded"
    (start, _), *_, (_, status) = messages(recorded, "/wm/learner/status")
    settings = [f"model:={status.model}"]
    reports["alone"] = run(arguments, env, arguments.out / "alone", arguments.alone, settings)

    errors = [(time, e.mse, e.persistence_mse) for time, e in messages(recorded, "/wm/prediction_error") if e.step == 1]
    ratios = by_minute(errors, start)
    print("| minute | error ratio one step ahead | n |\n|---|---|---|")
    for minute, ratio, n in ratios:
        print(f"| {minute} | {ratio:.3f} | {n} |")
    print()
    for bound in (0.9, 0.7):
        print(f"below {bound} for good since minute: {below(ratios, bound)}")

    rounds = [
        {
            "round": r.round,
            "time": r.stamp.sec + r.stamp.nanosec / 1e9,
            "trained_on": r.trained_on,
            "ratio": r.ratio,
            "ratio_before": r.ratio_before,
            "p": r.p_value,
            "accepted": r.accepted,
        }
        for r in status.rounds
    ]
    print("\n| round | ended, minute | trained on [s] | ratio | before | p | accepted |\n|---|---|---|---|---|---|---|")
    for r in rounds:
        minute = (r["time"] - start) / 60
        print(
            f"| {r['round']} | {minute:.1f} | {r['trained_on']:.0f} | {r['ratio']:.3f} | {r['ratio_before']:.3f} "
            f"| {r['p']:.3f} | {r['accepted']} |"
        )

    print("\n| step k | run | n | capture to received: p50 ms | p95 ms | p99 ms |\n|---|---|---|---|---|---|")
    for k in (0, 3, 7):
        for name, report in reports.items():
            latency = report["steps"][k]["received_latency"]
            print(f"| {k + 1} | {name} | {latency['n']} | {latency['p50_ms']:.1f} | {latency['p95_ms']:.1f} | {latency['p99_ms']:.1f} |")

    figures = {"start": start, "ratios": ratios, "rounds": rounds, "reports": reports}
    (arguments.out / "figures.json").write_text(json.dumps(figures, indent=1))
    draw(arguments.out / "learner.svg", {"live, calibrated": figures})


if __name__ == "__main__":
    main()
