#!/usr/bin/env python3
"""Matrix products and convolutions at the sizes of the published models: ours, those of the crate gemm, and PyTorch's, which
are oneDNN's (in f32 also MKL's, in int8 FBGEMM's). Also the share of the processor's measured peak that ours reach.
In int8 both round the inputs in the time that is measured.

usage: benches/products.py [--rounds N] [--threads T]

Builds `world-model/model/examples/kernel_speed.rs` and runs it by turns with PyTorch, on all threads of each; of all runs
the fastest counts. A share above 1: a convolution with fewer multiplications than its definition. Needs cargo, and the
packages of world-model/zoo/fixtures/requirements.txt.
"""

import argparse
import datetime
import os
import pathlib
import subprocess
import time
import warnings

import torch
import torch.nn.functional as F

from machine import processor

ROOT = pathlib.Path(__file__).resolve().parent.parent
FORMATS = {"f32": torch.float32, "bf16": torch.bfloat16, "int8": torch.qint8}


def ours(threads):
    """Billions of operations a second of what and format, the operations of each counted by the program."""
    binary = ROOT / "target/release/examples/kernel_speed"
    lines = subprocess.run([binary, str(threads)], check=True, capture_output=True, text=True).stdout.splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("|")]
    return {(what, number_format): float(rate) for what, number_format, rate, _ in rows[2:]}


def peer(what, dtype):
    """A closure that computes `what` in PyTorch, and its operations."""
    words = what.split()
    if words[0] == "product":
        rows, inputs, outputs = int(words[1]), int(words[3]), int(words[5])
        if dtype == torch.qint8:
            with warnings.catch_warnings():
                # It is to move to torchao, a package of its own.
                warnings.simplefilter("ignore")
                whole = torch.nn.Sequential(torch.nn.Linear(inputs, outputs, bias=False))
                types = {torch.nn.Linear: torch.ao.quantization.per_channel_dynamic_qconfig}
                linear = torch.ao.quantization.quantize_dynamic(whole, types)
            x = torch.full((rows, inputs), 0.5)
            return lambda: linear(x), 2 * rows * inputs * outputs
        linear = torch.nn.Linear(inputs, outputs, bias=False, dtype=dtype)
        x = torch.full((rows, inputs), 0.5, dtype=dtype)
        return lambda: linear(x), 2 * rows * inputs * outputs
    channels, side = int(words[2]), int(words[4])
    last = torch.channels_last
    weight = torch.full((channels, channels, 3, 3), 0.1, dtype=dtype).to(memory_format=last)
    x = torch.full((1, channels, side, side), 0.5, dtype=dtype).to(memory_format=last)
    return lambda: F.conv2d(x, weight, padding=1), 18 * channels * channels * side * side


def rate(run, operations):
    start = time.perf_counter()
    run()
    return operations / (time.perf_counter() - start) / 1e9


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--threads", type=int, default=len(os.sched_getaffinity(0)))
    arguments = parser.parse_args()
    build = ["cargo", "build", "--release", "-p", "wm_model", "--example", "kernel_speed"]
    subprocess.run(build, cwd=ROOT, check=True)
    torch.set_num_threads(arguments.threads)
    torch.set_grad_enabled(False)
    best, peers, theirs = {}, {}, {}
    for _ in range(arguments.rounds):
        for key, found in ours(arguments.threads).items():
            best[key] = max(best.get(key, 0.0), found)
        for what, number_format in best:
            if what == "peak" or number_format not in FORMATS:
                continue
            key = (what, number_format)
            if key not in peers:
                peers[key] = peer(what, FORMATS[number_format])
            found = max(rate(*peers[key]) for _ in range(3))
            theirs[key] = max(theirs.get(key, 0.0), found)
    peaks = {number_format: best["peak", number_format] for number_format in FORMATS}
    print(f"{processor()}, {arguments.threads} threads, {datetime.date.today()}, torch {torch.__version__}")
    print(f"peak: {', '.join(f'{name} {peak:.0f} Gop/s' for name, peak in peaks.items())}\n")
    print("| what | format | wm Gop/s | of the peak | gemm | PyTorch | wm's time / PyTorch's |")
    print("|---|---|---|---|---|---|---|")
    for (what, number_format), found in best.items():
        if (what, number_format) not in theirs:
            continue
        gemm = best.get((what, f"{number_format}, gemm"))
        share = f"{found / peaks[number_format]:.2f}" if peaks[number_format] else "-"
        other = theirs[what, number_format]
        cells = [what, number_format, f"{found:.0f}", share, f"{gemm:.0f}" if gemm else "-", f"{other:.0f}"]
        print("| " + " | ".join([*cells, f"{other / found:.2f}"]) + " |")


if __name__ == "__main__":
    main()
