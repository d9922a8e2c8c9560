#!/usr/bin/env python3
"""Many episodes by shards: imports, prepares, encodes, trains on and evaluates copies of an RLDS data set, and measures time and
memory of each stage by the number of episodes.

usage: benches/scale.py RLDS [--episodes 1000 10000] [--shards 8] [--by processes|ray|slurm|kubernetes] [--jobs N] [--size 64x64]
                        [--encoder MODEL] [--wm PATH] --out OUT

RLDS is a folder with one TFRecord file of Bridge V2's layout. Its file is linked as often as the number of episodes asks for.
Every shard is a command of its own, as in docs/evaluation.md. --by says who runs the commands: this program; Ray, as tasks
(`pip install ray`); or a shell with the variable that a Slurm array or an indexed Kubernetes job sets. Without --encoder, an
autoencoder for pictures of --size is trained for two steps: its latents are poor, and cheap. Prints Markdown: for each stage the
wall-clock time, the processor time of an episode, and the peak memory of a process without mapped files, which the kernel may
drop. OUT must not exist. Needs `cargo build --release` and `cargo build --release -p wm_training -p wm_import`.
"""

import argparse
import concurrent.futures
import contextlib
import datetime
import json
import os
import pathlib
import shlex
import subprocess
import tempfile
import time

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
SETTINGS = "control: {response_windows: 64, searches: []}\n"
ARRAYS = {"slurm": "SLURM_ARRAY_TASK_ID", "kubernetes": "JOB_COMPLETION_INDEX"}


def memory_of(process):
    """Memory of a process and its children now [MiB], without mapped files, which the kernel may drop."""
    total = 0
    waiting = [process]
    while waiting:
        folder = pathlib.Path(f"/proc/{waiting.pop()}")
        with contextlib.suppress(OSError):
            status = (folder / "status").read_text()
            total += sum(int(line.split()[1]) for line in status.splitlines() if line.startswith("RssAnon:"))
            waiting += (folder / f"task/{folder.name}/children").read_text().split()
    return total / 1024


def measured(command):
    """Runs a command. Returns its processor time [s] and its peak memory [MiB]."""
    with tempfile.TemporaryFile("w+") as errors:
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=errors) as process:
            peak = 0
            while (ended := os.wait4(process.pid, os.WNOHANG))[0] == 0:
                peak = max(peak, memory_of(process.pid))
                time.sleep(0.05)
            process.returncode = os.waitstatus_to_exitcode(ended[1])
        if process.returncode != 0:
            errors.seek(0)
            raise RuntimeError(f"{shlex.join(command)}: exit code {process.returncode}\n{errors.read()[-2000:]}")
    return ended[2].ru_utime + ended[2].ru_stime, peak


class Runner:
    """Runs the shards of a stage, `jobs` at once."""

    def __init__(self, by, jobs, shards):
        self.by, self.jobs, self.shards = by, jobs, shards
        if by == "ray":
            import ray  # pylint: disable=import-outside-toplevel,import-error

            ray.init(num_cpus=jobs, include_dashboard=False, log_to_driver=False)
            self.task = ray.remote(num_cpus=1)(measured)
            self.get = ray.get

    def run(self, command):
        """The processor time of all shards [s], and the highest peak memory of one [MiB]."""
        if self.by == "ray":
            shards = [[*command, "--shard", f"{i}/{self.shards}"] for i in range(self.shards)]
            found = self.get([self.task.remote(shard) for shard in shards])
        else:
            with concurrent.futures.ThreadPoolExecutor(self.jobs) as pool:
                found = list(pool.map(lambda i: measured(self.line(command, i)), range(self.shards)))
        return sum(seconds for seconds, _ in found), max(memory for _, memory in found)

    def line(self, command, index):
        """The command of a shard."""
        variable = ARRAYS.get(self.by)
        if variable is None:
            return [*command, "--shard", f"{index}/{self.shards}"]
        shell = f"exec {shlex.join(command)} --shard ${variable}/{self.shards}"
        return ["env", f"{variable}={index}", "sh", "-c", shell]


def copies(source, target, episodes):
    """Links the TFRecord of `source` until `target` has so many episodes. Returns their number."""
    record = next(source.glob("*.tfrecord*"))
    info = json.loads((source / "dataset_info.json").read_text())
    each = int(info["splits"][0]["shardLengths"][0])
    count = -(-episodes // each)
    target.mkdir(parents=True)
    for number in range(count):
        os.symlink(record.resolve(), target / f"bridge_dataset-train.tfrecord-{number:05}-of-{count:05}")
    return count * each


def stages(arguments, runner, episodes):
    """Runs the stages for so many episodes, and prints a row for each."""
    out = arguments.out / str(episodes)
    source, bags, data, model = (out / name for name in ("source", "bags", "data", "model"))
    count = copies(arguments.rlds, source, episodes)
    wm, encoder = arguments.wm, arguments.encoder

    def stage(name, run, command):
        began = time.monotonic()
        seconds, memory = run([str(part) for part in command])
        print(f"| {count} | {name} | {time.monotonic() - began:.0f} | {seconds / count * 1e3:.2f} | {memory:.0f} |", flush=True)

    stage("import, by shards", runner.run, [wm, "bag", "import", "bridge", source, bags])
    prepare = [wm, "dataset", bags, "-o", data, "--size", arguments.size, "--validation", "0.01"]
    stage("prepare", measured, prepare)
    if encoder is None:
        encoder = out / "encoder"
        height, width = arguments.size.split("x")
        small = ["--set", f"model.height={height}", "--set", f"model.width={width}", "--set", "crop=32", "--steps", "2"]
        stage("autoencoder, 2 steps", measured, [wm, "train", "autoencoder", "--data", data, "--out", encoder, *small])
    cache = ["--cache", out / "cache"]
    stage("latents, by shards", runner.run, [wm, "dataset", "latents", data, "--encoder", encoder, *cache])
    stage("latents, joined", measured, [wm, "dataset", "latents", data, "--encoder", encoder, *cache])
    train = [wm, "train", "transition", "--data", data, "--encoder", encoder, "--out", model, *cache, "--steps", "20"]
    # The episodes of the sample have ten frames, which is one clip without skipped frames.
    small = [f"--set={setting}" for setting in ("model.frames=4", "model.frame_skip=1", "batch=2", "micro_batch=1")]
    stage("transition model, 20 steps", measured, [*train, *small])
    settings = out / "settings.yaml"
    settings.write_text(SETTINGS)
    evaluate = [wm, "eval", "control", "--model", model, "--data", data, "--settings", settings, *cache]
    evaluate += ["--records", out / "records"]
    stage("evaluation, by shards", runner.run, evaluate)
    stage("evaluation, merged", measured, [wm, "eval", "merge", out / "records", "--report", out / "report"])


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("rlds", type=pathlib.Path)
    parser.add_argument("--episodes", type=int, nargs="+", default=[1000, 10000])
    parser.add_argument("--shards", type=int, default=8)
    parser.add_argument("--by", choices=["processes", "ray", *ARRAYS], default="processes")
    parser.add_argument("--jobs", type=int, default=os.cpu_count())
    parser.add_argument("--size", default="64x64")
    parser.add_argument("--encoder")
    parser.add_argument("--wm", default=str(ROOT / "target/release/wm"))
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args()
    arguments.out = arguments.out.resolve()
    arguments.out.mkdir(parents=True)
    runner = Runner(arguments.by, arguments.jobs, arguments.shards)
    print(f"{processor()}, {datetime.date.today()}, {arguments.shards} shards by {arguments.by}, {arguments.jobs} at once\n")
    print("| episodes | stage | time \\[s\\] | processor time of an episode \\[ms\\] | peak memory of a process \\[MiB\\] |")
    print("|---|---|---|---|---|", flush=True)
    for episodes in arguments.episodes:
        stages(arguments, runner, episodes)


if __name__ == "__main__":
    main()
