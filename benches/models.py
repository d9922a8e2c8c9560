#!/usr/bin/env python3
"""The models' engine against PyTorch on the same machine, with the same weights and inputs.

usage: benches/models.py [--device cuda] [--rounds N] [--seconds S] [--no-compile] [CASE ...]

Builds `learning/training/examples/model_speed.rs`, and for each case writes random weights and an input to a temporary
folder, then runs ours and PyTorch (eager, and with torch.compile) in turns, round by round, on all threads of each. Of
all runs it prints the medians, of the rounds' ratios of ours to the faster PyTorch the median and the range (below 1:
ours is faster), and how far our output and that of eager are from eager's in f32 (relative, Euclidean). `candle` is the
same network on candle's own CPU operations, with its time divided by ours. `at the peak` is the time of eager's
multiplications and additions at the measured peak of the processor for the format, if ours computes the same ones: no
arrangement of them is faster, but convolutions take fewer. Needs cargo, a C++ compiler, and the packages of
world-model/zoo/fixtures/requirements.txt.

Cases: velocity-dit-s, velocity-dit-l: one velocity of a new frame after nine frames with cached keys and values, on
both sides. frame-dit-s: a predicted frame, ten Euler steps in a full window of ten, ours with its exact cache, the
reference's loop without. plan-dit-s: the same for 64 candidates after two frames; the peers compute two of them, and
their time counts 32 times. vit-l, sd3-encode, sd3-decode, pixel: one picture of 256 x 256. Those of one velocity and
vit-l also in int8, beside PyTorch's dynamic quantisation. Last, load: time and memory to load a model of 300 M
parameters, packing its weights (first) and finding them packed (kept).

With --device cuda, all on an NVIDIA GPU: cargo then needs nvcc (tests/setup_cuda installs one), and PyTorch its own
CUDA. Ours repeats recorded passes (CUDA graphs) of few tokens, unless --no-graphs is given. TensorRT is one more peer
if torch_tensorrt is installed. One more case is step-dit-l, and load is skipped: one velocity of 64 candidates of DiT-L
in one batch, without a peer, with the share of the card's peak that its operations are, and the loss of free memory of
the card. The peak is that of a product of 8192 x 8192 matrices in PyTorch, bf16, in the same run.
"""

import argparse
import copy
import datetime
import importlib.util
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time
import warnings

import torch
import torch.nn.functional as F
from diffusers import AutoencoderKL
from safetensors.torch import load_file, save_file
from torch.utils.flop_counter import FlopCounterMode
from transformers import Dinov2Config, Dinov2Model

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "world-model/zoo/fixtures"))

from card_memory import CardMemory  # noqa: E402
from cases.autoencoder import SD3, to_signed, to_unit  # noqa: E402
from cases.case import channels_first, channels_last, pictures, randomised, resized, saved  # noqa: E402
from cases.transition import dit_input  # noqa: E402
from machine import processor  # noqa: E402
from reference import dit, pixel_decoder, vjepa  # noqa: E402

FORMATS = {"f32": torch.float32, "bf16": torch.bfloat16}
# Of models whose time is that of matrices; on the CPU only.
MATRIX_FORMATS = (*FORMATS, "int8")
# The place of candle's own operations on the CPU, for model_speed.
CANDLE = ("candle",)
DIT_S = dit.DIT_L_SD3 | dict(hidden=384, depth=12, heads=6)
EULER_STEPS, CONTEXT_TAU = 10, 0.01


def dynamically_quantised(model):
    """Every Linear with weights in 8 bits, a scale for each output, and inputs that are rounded when it runs."""
    quantization = torch.ao.quantization
    with warnings.catch_warnings():
        # It is to move to torchao, a package of its own.
        warnings.simplefilter("ignore")
        return quantization.quantize_dynamic(model, {torch.nn.Linear: quantization.per_channel_dynamic_qconfig})


class Case:
    """One model and an input. `step` computes in PyTorch what `ours` names in model_speed.rs."""

    ours = output = None
    formats = tuple(FORMATS)
    # The factor of work of ours over the peers', by which their times are multiplied.
    share = 1
    # Operations of ours in a run, for the share of the card's peak.
    operations = None
    # Whether the peers compute the same operations as ours.
    same_operations = True

    def __init__(self):
        torch.manual_seed(1)
        self.config, self.model, self.inputs = self.build()

    def at(self, number_format):
        """A copy of the case in another number format."""
        other = copy.copy(self)
        # The default device: that of the run.
        device = torch.get_default_device()
        dtype = FORMATS.get(number_format, torch.float32)
        other.model = copy.deepcopy(self.model).to(device, dtype)
        if number_format == "int8":
            other.model = dynamically_quantised(other.model)
        other.inputs = {name: value.to(device, dtype) for name, value in self.inputs.items()}
        other.ready()
        return other

    def ready(self):
        """Preparation that is not part of the time of a step."""

    def weights(self):
        """By the names of a published checkpoint."""
        return self.model.state_dict()

    def compiled(self):
        other = copy.copy(self)
        other.step = torch.compile(self.step)
        return other


    def tensor_rt(self):
        other = copy.copy(self)
        other.step = torch.compile(self.step, backend="torch_tensorrt")
        return other


class Velocity(Case):
    """The reference's layers run for one new frame, whose temporal attention sees cached keys and values."""

    ours, output, cached, formats = "velocity", "velocity", 9, MATRIX_FORMATS

    def __init__(self, config):
        self.config = config
        super().__init__()

    def build(self):
        return self.config, randomised(dit.dit(**self.config)), dit_input(self.config, 1, 10)

    def ready(self):
        c, self.module = self.config, dit.transition_module()
        self.spatial, self.temporal = self.spatial_block, self.temporal_block
        dtype = self.inputs["x"].dtype
        rows, columns = (side // c["patch"] for side in c["grid"])
        self.heads, self.dim = c["heads"], c["hidden"] // c["heads"]
        row, column = torch.arange(rows).repeat_interleave(columns), torch.arange(columns).repeat(rows)
        angles = self.module.axis_angles
        turn = lambda a: (a.cos().to(dtype), a.sin().to(dtype))
        # As a careful user does: constants are computed once.
        self.space = turn(torch.cat((angles(row, self.dim // 2), angles(column, self.dim // 2)), -1))
        self.times = [turn(angles(torch.tensor([t]), self.dim)) for t in range(self.cached + 1)]
        self.frequencies = torch.exp(-torch.log(torch.tensor(10000.0)) * torch.arange(128) / 128)
        empty = torch.empty(rows * columns, self.heads, 0, self.dim, dtype=dtype)
        self.cache = [(empty, empty)] * c["depth"]
        for t in range(self.cached):
            self.cache = self.frame(t)[1]

    def turned(self, x, angles):
        x = F.rms_norm(x, (self.dim,), eps=torch.finfo(x.dtype).eps)
        a, b = x[..., 0::2], x[..., 1::2]
        cos, sin = angles
        return torch.stack((a * cos - b * sin, a * sin + b * cos), -1).flatten(-2)

    def qkv(self, block, x, modulation):
        shift, scale = modulation[:2]
        qkv = block.attn.qkv_proj(self.module.modulated(x, shift, scale))
        return qkv.view(x.shape[0], 3, self.heads, self.dim).unbind(1)

    def rest(self, block, x, attended, modulation):
        _, _, gate1, shift2, scale2, gate2 = modulation
        x = x + gate1 * block.attn.out_proj(attended)
        return x + gate2 * block.ffwd(self.module.modulated(x, shift2, scale2))

    def spatial_block(self, block, x, condition):
        modulation = block.adaLN_modulation(condition).chunk(6, -1)
        q, k, v = (t.transpose(0, 1)[None] for t in self.qkv(block, x, modulation))
        out = F.scaled_dot_product_attention(self.turned(q, self.space), self.turned(k, self.space), v)
        return self.rest(block, x, out[0].transpose(0, 1).flatten(1), modulation)

    def temporal_block(self, block, x, condition, angles, keys, values):
        modulation = block.adaLN_modulation(condition).chunk(6, -1)
        q, k, v = (t.unsqueeze(2) for t in self.qkv(block, x, modulation))
        keys, values = torch.cat((keys, self.turned(k, angles)), 2), torch.cat((values, v), 2)
        out = F.scaled_dot_product_attention(self.turned(q, angles), keys, values)
        return self.rest(block, x, out.flatten(1), modulation), (keys, values)

    def frame(self, t):
        """The velocity of frame `t` after the cached ones, and the cache with it."""
        model, cache = self.model, []
        x, tau, action = (self.inputs[name][:, t] for name in ("x", "tau", "action"))
        tokens = model.x_proj(x.permute(0, 3, 1, 2)).flatten(2).transpose(1, 2)[0]
        waves = (tau.float() * 1000)[:, None] * self.frequencies
        time = model.timestep_mlp(torch.cat((waves.cos(), waves.sin()), -1).to(x.dtype))
        condition = time + model.action_embedder(action)
        for block, (keys, values) in zip(model.blocks, self.cache):
            tokens = self.spatial(block.s_block, tokens, condition)
            tokens, entry = self.temporal(block.t_block, tokens, condition, self.times[t], keys, values)
            cache.append(entry)
        head = model.final_layer
        shift, scale = head.adaLN_modulation(condition).chunk(2, -1)
        patches = head.linear(self.module.modulated(tokens, shift, scale))
        (h, w), p = self.config["grid"], self.config["patch"]
        grid = patches.view(h // p, w // p, p, p, -1).transpose(1, 2)
        return grid.reshape(1, 1, h, w, -1), cache

    def step(self):
        return self.frame(self.cached)[0]

    def compiled(self):
        # One block, which all of the model share: the whole would take minutes to compile.
        other = copy.copy(self)
        other.spatial, other.temporal = torch.compile(self.spatial_block), torch.compile(self.temporal_block)
        return other


class Step(Case):
    """One Euler step of a plan: the new frame of many candidates, after frames of their own."""

    ours, output, formats, candidates, cached = "velocity", "velocity", ("bf16",), 64, 2

    def build(self):
        config = dit.DIT_L_SD3
        d, h = config["hidden"], 2 * (4 * config["hidden"] // 3)
        tokens = config["grid"][0] * config["grid"][1] // config["patch"] ** 2
        # A multiplication and an addition are two; of the attention that within frames.
        of_token = 2 * (4 * d * d + 3 * d * h) + 2 * tokens * d
        self.operations = 2 * self.candidates * tokens * config["depth"] * of_token
        model = randomised(dit.dit(**config))
        return config, model, dit_input(config, self.candidates, self.cached + 1)


class Frame(Case):
    """The reference's loop: every Euler step computes the whole window of every candidate."""

    ours, output, same_operations = "frame", "predicted", False
    # In f32 only: on a processor without bf16 arithmetic, the loop takes minutes in PyTorch's bf16.
    formats = ("f32",)

    def __init__(self, observed, candidates):
        self.observed, self.candidates = observed, candidates
        # Each candidate is as much work for the reference, half a minute of it: no need to wait for all.
        self.peer_candidates = min(candidates, 2)
        self.share = candidates / self.peer_candidates
        super().__init__()

    def build(self):
        model = randomised(dit.dit(**DIT_S))
        # A small velocity, as of a trained model: else errors grow over the Euler steps, and nothing can be compared.
        model.final_layer.linear.weight.data *= 0.25
        frame = (*DIT_S["grid"], DIT_S["channels"])
        actions = torch.randn(1, self.observed + 1, 10).repeat(self.candidates, 1, 1)
        actions[:, -2] = torch.randn(self.candidates, 10)
        inputs = dict(
            context=torch.randn(1, self.observed, *frame), actions=actions, noise=torch.randn(1, 1, *frame)
        )
        return DIT_S, model, inputs

    def step(self):
        # That of models of such latents, `published_shift`.
        shift = max(1, (256 * DIT_S["channels"] / DIT_S["patch"] ** 2 / 4096) ** 0.5)
        actions = self.inputs["actions"][: self.peer_candidates]
        context, noise = (self.inputs[name].expand(len(actions), -1, -1, -1, -1) for name in ("context", "noise"))
        options = dict(max_frames=10, steps=EULER_STEPS, shift=shift, context_tau=CONTEXT_TAU)
        return dit.rollout(self.model, context, actions, noise, **options)

    def compiled(self):
        other = copy.copy(self)
        other.model = copy.deepcopy(self.model)
        for block in other.model.blocks:
            block.compile()
        return other


class VitL(Case):
    ours, output, formats = "web-dino", "latent", MATRIX_FORMATS

    def build(self):
        model = Dinov2Model(
            Dinov2Config(
                hidden_size=1024, num_hidden_layers=24, num_attention_heads=16, mlp_ratio=4, image_size=224,
                patch_size=14, use_swiglu_ffn=False, layer_norm_eps=1e-6,
            )
        )
        config, self.published = saved(randomised(model))
        return config, model, dict(image=pictures(1, 256, 256))

    def weights(self):
        return self.published

    def step(self):
        image = resized(channels_first(self.inputs["image"]), 224)
        mean, std = (torch.tensor(v, dtype=image.dtype).view(3, 1, 1) for v in (vjepa.MEAN, vjepa.STD))
        return self.model((image - mean) / std).last_hidden_state[:, 1:].unflatten(1, (16, 16))


class Convolutional(Case):
    """Channels last in PyTorch, too: it is faster so."""

    def ready(self):
        self.model.to(memory_format=torch.channels_last)


class Sd3(Convolutional):
    def build(self):
        options = dict(SD3, widths=[128, 256, 512, 512], norm_num_groups=32, latent_channels=16)
        widths = options.pop("widths")
        model = AutoencoderKL(
            block_out_channels=widths, down_block_types=["DownEncoderBlock2D"] * 4,
            up_block_types=["UpDecoderBlock2D"] * 4, **options,
        )
        self.shift, self.scale = options["shift_factor"], options["scaling_factor"]
        randomised(model)
        return dict(model.config), model, self.input()


class Sd3Encoder(Sd3):
    ours, output = "sd3-vae", "latent"

    def input(self):
        return dict(image=pictures(1, 256, 256))

    def step(self):
        mean = self.model.encode(to_signed(self.inputs["image"])).latent_dist.mean
        return channels_last((mean - self.shift) * self.scale)


class Sd3Decoder(Sd3):
    ours, output = "sd3-vae-decoder", "image"

    def input(self):
        return dict(latent=torch.randn(1, 32, 32, 16))

    def step(self):
        latent = channels_first(self.inputs["latent"]) / self.scale + self.shift
        return to_unit(self.model.decode(latent).sample)


class Pixel(Convolutional):
    ours, output = "pixel", "image"

    def build(self):
        config = pixel_decoder.PUBLISHED
        model = randomised(pixel_decoder.PixelDecoder(**config))
        return config, model, dict(latent=torch.randn(1, 16, 16, config["latent"]))

    def step(self):
        return channels_last(self.model(channels_first(self.inputs["latent"])))


CASES = {
    "velocity-dit-s": lambda: Velocity(DIT_S),
    "velocity-dit-l": lambda: Velocity(dit.DIT_L_SD3),
    "frame-dit-s": lambda: Frame(9, 1),
    "plan-dit-s": lambda: Frame(2, 64),
    "vit-l": VitL,
    "sd3-encode": Sd3Encoder,
    "sd3-decode": Sd3Decoder,
    "pixel": Pixel,
}
ON_CUDA = CASES | {"step-dit-l": Step}


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
        if number_format not in FORMATS and place:
            continue
        at = case.at(number_format)
        peers = dict(eager=at)
        # What is quantised dynamically cannot be compiled.
        if not arguments.no_compile and number_format in FORMATS:
            peers["compile"] = at.compiled()
        if place and importlib.util.find_spec("torch_tensorrt"):
            import torch_tensorrt  # noqa: F401, registers the backend

            peers["tensorrt"] = at.tensor_rt()
        firsts = {peer: first_run(of) for peer, of in peers.items()}
        if reference is None:
            reference = firsts["eager"][0].float()
            operations = operations_of(at) if case.same_operations and peaks else None
        slowest = max(ms for _, ms in firsts.values()) / 1e3
        runs = max(1, min(10, int(arguments.seconds / slowest)))
        rounds = 1 if slowest > arguments.seconds else arguments.rounds
        all_ours, theirs, ratios = [], {peer: [] for peer in peers}, []
        candles, gains = [], []
        for _ in range(rounds):
            # Before ours, whose output is compared.
            has_candle = not place and number_format in FORMATS
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
        columns = ("eager", "compile", *(["tensorrt"] if place else []))
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
    parser.add_argument("--no-compile", action="store_true", help="leave torch.compile out")
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
    print(f"{card}{processor()}, {flags}, {cores} cores, {datetime.date.today()}, torch {torch.__version__}\n")
    peaks = {} if on_cuda else processor_peaks(cores)
    more = " TensorRT p50 ms |" if on_cuda else " candle p50 ms (to ours) | at the peak ms |"
    print(f"| case | format | ours p50 ms | eager p50 ms | compile p50 ms |{more} ratio to the fastest | difference | eager's | runs |")
    print("|---" * (10 if on_cuda else 11) + "|")
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
