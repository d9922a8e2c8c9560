"""The cases of benches/models.py: networks with random weights and an input, computed in PyTorch by the reference code."""

import copy
import pathlib
import sys
import warnings

import torch
import torch.nn.functional as F
from diffusers import AutoencoderKL
from transformers import Dinov2Config, Dinov2Model

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parent.parent / "world-model/zoo/fixtures"))

from cases.autoencoder import SD3, to_signed, to_unit  # noqa: E402
from cases.case import channels_first, channels_last, pictures, randomised, resized, saved  # noqa: E402
from cases.transition import dit_input  # noqa: E402
from reference import dit, pixel_decoder, vjepa  # noqa: E402

FORMATS = {"f32": torch.float32, "bf16": torch.bfloat16}
# Of models whose time is that of matrices; on the CPU only.
MATRIX_FORMATS = (*FORMATS, "int8")
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
    # Whether engines of others run it: not loops over whole windows.
    is_exported = True
    # The inputs of the exported step, once it is.
    exported = None

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

    def engine_inputs(self):
        """The inputs of an engine's step, by names."""
        return self.inputs

    def with_engine_inputs(self, values):
        """The case with other values of `engine_inputs`."""
        other = copy.copy(self)
        other.inputs = dict(zip(self.inputs, values))
        return other

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

    def engine_inputs(self):
        """The new frame alone, and the cache."""
        cache = [tensor for entry in self.cache for tensor in entry]
        new = {name: value[:, self.cached :] for name, value in self.inputs.items()}
        return new | {f"cache{number}": tensor for number, tensor in enumerate(cache)}

    def with_engine_inputs(self, values):
        other = copy.copy(self)
        count = len(self.inputs)
        other.inputs = dict(zip(self.inputs, values))
        other.cache = [*zip(values[count::2], values[count + 1 :: 2])]
        other.times, other.cached = [self.times[self.cached]], 0
        return other

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

    ours, output, same_operations, is_exported = "frame", "predicted", False, False
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
