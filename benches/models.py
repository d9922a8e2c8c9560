#!/usr/bin/env python3
"""The models' engine against PyTorch on the same machine, with the same weights and inputs.

usage: benches/models.py [--device cuda] [--rounds N] [--seconds S] [--formats F ...] [--no-compile] [--no-candle] [CASE ...]

Builds `learning/training/examples/model_speed.rs`, and for each case writes random weights and an input to a temporary
folder, then runs ours, PyTorch (eager, and with torch.compile), ONNX Runtime and OpenVINO in turns, round by round, on all
threads of each (benches/engines.py; a peer that is not installed is left out). Of all runs it prints the medians, of the
rounds' ratios of ours to the fastest peer the median and the range (below 1: ours is faster), and how far our output and
that of eager are from eager's in f32 (relative, Euclidean). `candle` is the
same network on candle's own CPU operations, with its time divided by ours. `at the peak` is the time of eager's
multiplications and additions at the measured peak of the processor for the format, if ours computes the same ones: no
arrangement of them is faster, but convolutions take fewer. Needs cargo, a C++ compiler, and the packages of
world-model/zoo/fixtures/requirements.txt; for the engines also onnx, onnxscript, onnxruntime, openvino and nncf.

Cases: velocity-dit-s, velocity-dit-l: one velocity of a new frame after nine frames with cached keys and values, on
both sides. frame-dit-s: a predicted frame, ten Euler steps in a full window of ten, ours with its exact cache, the
reference's loop without. plan-dit-s: the same for 64 candidates after two frames; the peers compute two of them, and
their time counts 32 times; only PyTorch is a peer. vit-l, sd3-encode, sd3-decode, pixel: one picture of 256 x 256. Those
of one velocity and vit-l also in int8, beside the dynamic quantisation of PyTorch and ONNX Runtime, and that of OpenVINO's
NNCF. Last, load: time and memory to load a model of 300 M
parameters, packing its weights (first) and finding them packed (kept).

With --device cuda, all on an NVIDIA GPU: cargo then needs nvcc (tests/setup_cuda installs one), and PyTorch its own
CUDA. Ours repeats recorded passes (CUDA graphs) of few tokens, unless --no-graphs is given. TensorRT is one more peer
if torch_tensorrt is installed. One more case is step-dit-l, and load is skipped: one velocity of 64 candidates of DiT-L
in one batch, without a peer, with the share of the card's peak that its operations are, and the loss of free memory of
the card. The peak is that of a product of 8192 x 8192 matrices in PyTorch, bf16, in the same run.
"""

import argparse
import datetime
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import torch
from safetensors.torch import load_file, save_file
from torch.utils.flop_counter import FlopCounterMode

from card_memory import CardMemory
from engines import engines, installed, versions
from machine import processor
from model_cases import CASES, FORMATS, MATRIX_FORMATS, ON_CUDA, VitL

ROOT = pathlib.Path(__file__).resolve().parent.parent
# The place of candle's own operations on the CPU, for model_speed.
CANDLE = ("candle",)


def write(case, folder):
    (folder / "config.json").write_text(json.dumps(case.config))
    for name, tensors in dict(weights=case.weights(), input=case.inputs).items():
        save_file({key: value.contiguous() for key, value in tensors.items()}, folder / f"{name}.safetensors")


def ours(what, folder, number_format, runs, warm=1, place=("cpu",), cache=None):
    """The lines of model_speed, by their names; its first run fills caches and is skipped, unless `warm` is 0."""
    binary = ROOT / "target/release/examples/model_speed"
    kept = [f"--keep={cache}"] if cache else []
    arguments = [binary, what, folder, number_format, str(runs + warm if runs else 0), *place, *kept]
    # As the program `wm` sets them for itself; candle's own operations get all cores.
    threads = len(os.sched_getaffinity(0)) if place == CANDLE else 1
    environment = os.environ | dict(CANDLE_NUM_THREADS=str(threads), MIMALLOC_PURGE_DELAY="1000")
    result = subprocess.run(arguments, check=True, capture_output=True, text=True, env=environment)
    lines = {}
    for line in result.stdout.splitlines():
        name, number = line.split()
        lines.setdefault(name, []).append(float(number))
    return lines | dict(run_ms=lines.get("run_ms", [])[warm:])


def timed(step, runs):
    times = []
    for _ in range(runs):
        start = time.perf_counter()
        step()
        if torch.cuda.is_initialized():
            torch.cuda.synchronize()
        times.append((time.perf_counter() - start) * 1e3)
    return times


def first_run(case):
    """The output, and the milliseconds of a run: the second, for the first one compiles and fills caches."""
    output = case.step()
    return output, timed(case.step, 1)[0]


def processor_peaks(cores):
    """Operations a second of every format, on all cores."""
    binary = ROOT / "target/release/examples/kernel_speed"
    lines = subprocess.run([binary, str(cores), "peaks"], check=True, capture_output=True, text=True).stdout.splitlines()
    rows = [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith("| peak")]
    return {number_format: 1e9 * float(rate) for _, number_format, rate, _ in rows}


def operations_of(case):
    """Multiplications and additions of a step."""
    with FlopCounterMode(display=False) as counter:
        case.step()
    return counter.get_total_flops()


def card_peak():
    """Operations a second of a large product, in bf16."""
    n = 8192
    a, b = (torch.randn(n, n, dtype=torch.bfloat16, device="cuda") for _ in range(2))
    timed(lambda: a @ b, 5)
    return 2 * n**3 / (statistics.median(timed(lambda: a @ b, 20)) / 1e3)


def step_on_card(name, case, folder, place, runs=10):
    """A row of its own, compared only with the card's peak."""
    with CardMemory() as memory:
        ms = statistics.median(ours(case.ours, folder, "bf16", runs, warm=3, place=place)["run_ms"])
    rate, peak = case.operations / (ms / 1e3), card_peak()
    print(
        f"\n{name}, {case.candidates} candidates in bf16: p50 {ms:.1f} ms of {runs} runs, {rate / 1e12:.0f} TFLOP/s, "
        f"{rate / peak:.2f} of {peak / 1e12:.0f} TFLOP/s; {memory.most():.0f} MiB on the card at most\n",
        flush=True,
    )


def compare(name, case, folder, arguments, place, peaks):
    reference = operations = None
    for number_format in case.formats:
        if number_format not in (FORMATS if place else arguments.formats):
            continue
        at = case.at(number_format)
        peers = dict(eager=at)
        # What is quantised dynamically cannot be compiled.
        if not arguments.no_compile and number_format in FORMATS:
            peers["compile"] = at.compiled()
        if place and installed("torch_tensorrt"):
            import torch_tensorrt  # noqa: F401, registers the backend

            peers["tensorrt"] = at.tensor_rt()
        if not place:
            peers |= engines(case, number_format, folder, len(os.sched_getaffinity(0)))
        firsts = {peer: first_run(of) for peer, of in peers.items()}
        if reference is None:
            # In f32, whichever formats are compared.
            in_f32 = firsts["eager"][0] if number_format == "f32" else case.at("f32").step()
            reference = in_f32.float()
            operations = operations_of(at) if case.same_operations and peaks else None
        slowest = max(ms for _, ms in firsts.values()) / 1e3
        runs = max(1, min(10, int(arguments.seconds / slowest)))
        rounds = 1 if slowest > arguments.seconds else arguments.rounds
        all_ours, theirs, ratios = [], {peer: [] for peer in peers}, []
        candles, gains = [], []
        for _ in range(rounds):
            # Before ours, whose output is compared.
            has_candle = not place and number_format in FORMATS and not arguments.no_candle
            candle = ours(case.ours, folder, number_format, min(runs, 3), place=CANDLE)["run_ms"] if has_candle else []
            # Of recorded passes, the first two are not repeated ones.
            a = ours(case.ours, folder, number_format, runs, warm=3 if place else 1, place=place)["run_ms"]
            b = {peer: [ms * case.share for ms in timed(of.step, runs)] for peer, of in peers.items()}
            all_ours += a
            for peer, times in b.items():
                theirs[peer] += times
            ratios.append(statistics.median(a) / min(map(statistics.median, b.values())))
            if candle:
                candles += candle
                gains.append(statistics.median(candle) / statistics.median(a))
        output = load_file(folder / "output.safetensors")[case.output].float()[: len(reference)]
        output = output.to(reference.device)
        differences = [
            f"{((found - reference).norm() / reference.norm()).item():.1e}"
            for found in (output, firsts["eager"][0].float())
        ]
        columns = ("eager", "compile", *(["tensorrt"] if place else ["onnxruntime", "openvino"]))
        medians = [statistics.median(theirs[peer]) if peer in theirs else None for peer in columns]
        cells = [f"{m:.1f}" if m else "-" for m in (statistics.median(all_ours), *medians)]
        ratio = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
        if not place:
            cells.append(f"{statistics.median(candles):.1f} ({statistics.median(gains):.2f})" if candles else "-")
            peak = peaks[number_format]
            cells.append(f"{1e3 * operations / peak:.1f}" if operations and peak else "-")
        row = [name, number_format, *cells, ratio, *differences, f"{rounds} x {runs}"]
        print("| " + " | ".join(row) + " |", flush=True)


# PyTorch maps the file: it is loaded once the values have been read.
LOAD = """
import pathlib, sys, time, torch
from transformers import Dinov2Model
def resident():
    lines = pathlib.Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS:")) / 1024
before, start = resident(), time.perf_counter()
model = Dinov2Model.from_pretrained(sys.argv[1], dtype=getattr(torch, sys.argv[2]))
total = sum(p.sum().item() for p in model.parameters())
print((time.perf_counter() - start) * 1e3, resident() - before)
"""


def load(folder, rounds):
    case = VitL()
    write(case, folder)
    case.model.save_pretrained(folder / "transformers")
    weights = (folder / "weights.safetensors").stat().st_size / 2**20
    print(f"\nLoading ViT-L, a file of {weights:.0f} MiB (f32); memory without what the process needed before:\n")
    print("| weights as | start | ours ms | PyTorch ms | ratio (range) | ours at most MiB | PyTorch after it MiB |")
    print("|---|---|---|---|---|---|---|")
    cache = folder / "packed"
    # A checkpoint that has just been written may still change, and is not kept.
    time.sleep(3)
    for number_format, dtype in dict(f32="float32", bf16="bfloat16").items():
        starts, b = dict(first=[], kept=[]), []
        # Writes what the others find.
        ours("web-dino", folder, number_format, 0, cache=cache)
        for _ in range(rounds):
            for start, runs in starts.items():
                lines = ours("web-dino", folder, number_format, 0, cache=cache if start == "kept" else None)
                runs.append((lines["load_ms"][0], lines["peak_mib"][0]))
            command = [sys.executable, "-c", LOAD, folder / "transformers", dtype]
            result = subprocess.run(command, check=True, capture_output=True, text=True)
            b.append(tuple(map(float, result.stdout.split())))
        their_ms, their_peak = (statistics.median(column) for column in zip(*b))
        for start, a in starts.items():
            ms, peak = (statistics.median(column) for column in zip(*a))
            ratios = [mine / theirs for (mine, _), (theirs, _) in zip(a, b)]
            ratio = f"{statistics.median(ratios):.2f} ({min(ratios):.2f} to {max(ratios):.2f})"
            cells = [number_format, start, f"{ms:.0f}", f"{their_ms:.0f}", ratio, f"{peak:.0f}", f"{their_peak:.0f}"]
            print("| " + " | ".join(cells) + " |", flush=True)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", metavar="CASE")
    parser.add_argument("--device", choices=["cpu", "cuda"], default="cpu")
    parser.add_argument("--no-graphs", action="store_true", help="with --device cuda: record no passes")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=15, help="how long one peer's runs of a round may take, about")
    parser.add_argument("--formats", nargs="+", choices=MATRIX_FORMATS, default=MATRIX_FORMATS, help="on the CPU")
    parser.add_argument("--no-compile", action="store_true", help="leave torch.compile out")
    parser.add_argument("--no-candle", action="store_true", help="leave candle's own operations out, the slowest column")
    arguments = parser.parse_args()
    on_cuda = arguments.device == "cuda"
    known = [*ON_CUDA] if on_cuda else [*CASES, "load"]
    if unknown := set(arguments.cases) - set(known):
        parser.error(f"no such case: {', '.join(sorted(unknown))}; there are: {', '.join(known)}")
    if on_cuda and not torch.cuda.is_available():
        parser.error("--device cuda: PyTorch sees no GPU")
    build = ["cargo", "build", "--release", "-p", "wm_training", "--example", "model_speed"]
    build += ["--features", "cuda"] if on_cuda else []
    subprocess.run(build, cwd=ROOT, check=True)
    if not on_cuda:
        kernels = ["cargo", "build", "--release", "-p", "wm_model", "--example", "kernel_speed"]
        subprocess.run(kernels, cwd=ROOT, check=True)
    cores = len(os.sched_getaffinity(0))
    torch.set_num_threads(cores)
    torch.set_grad_enabled(False)
    flags = "AVX-512" if torch.cpu._is_avx512_supported() else "AVX2" if torch.cpu._is_avx2_supported() else "baseline"
    card = f"{torch.cuda.get_device_name()}, CUDA {torch.version.cuda}, " if on_cuda else ""
    print(f"{card}{processor()}, {flags}, {cores} cores, {datetime.date.today()}, torch {torch.__version__}{versions()}")
    print()
    peaks = {} if on_cuda else processor_peaks(cores)
    more = " ONNX Runtime p50 ms | OpenVINO p50 ms | candle p50 ms (to ours) | at the peak ms |"
    more = " TensorRT p50 ms |" if on_cuda else more
    print(f"| case | format | ours p50 ms | eager p50 ms | compile p50 ms |{more} ratio to the fastest | difference | eager's | runs |")
    print("|---" * (10 if on_cuda else 13) + "|")
    place = () if not on_cuda else ("cuda",) if arguments.no_graphs else ("cuda", "recorded")
    cases = arguments.cases or known
    for name in cases:
        if name == "load":
            continue
        with tempfile.TemporaryDirectory() as folder:
            folder, case = pathlib.Path(folder), ON_CUDA[name]()
            write(case, folder)
            if case.operations:
                step_on_card(name, case, folder, place)
                continue
            with torch.device(arguments.device):
                compare(name, case, folder, arguments, place, peaks)
    if "load" in cases:
        with tempfile.TemporaryDirectory() as folder:
            load(pathlib.Path(folder), arguments.rounds)


if __name__ == "__main__":
    main()
