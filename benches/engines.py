"""Inference engines of others on the CPU, as peers of benches/models.py: a case exported by torch.onnx, run by ONNX Runtime
and by OpenVINO."""

import importlib.metadata
import importlib.util
import logging
import pathlib
import warnings

import torch

# Where a processor lacks it, they compute in f32 instead.
BF16_FLAGS = ("avx512_bf16", "amx_bf16", "avx10")


def installed(package):
    return importlib.util.find_spec(package) is not None


def versions():
    """Those of the installed engines, for the head of a table."""
    names = [name for name in ("onnxruntime", "openvino", "nncf") if installed(name)]
    return "".join(f", {name} {importlib.metadata.version(name)}" for name in names)


def flags():
    """The instruction sets of the processor, as Linux names them."""
    return set(pathlib.Path("/proc/cpuinfo").read_text().split())


def has_bf16():
    """Whether the processor multiplies in bf16."""
    return not flags().isdisjoint(BF16_FLAGS)


class Exported(torch.nn.Module):
    """A case's step as a function of its inputs, all of which a robot's node would pass anew: none is folded into the
    graph."""

    def __init__(self, case):
        super().__init__()
        self.case, self.model = case, case.model

    def forward(self, *inputs):
        return self.case.with_engine_inputs(inputs).step()


def export(case, file):
    """Writes the case as ONNX, with static shapes; returns its inputs as arrays, by their names."""
    inputs = case.engine_inputs()
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        program = torch.onnx.export(
            Exported(case), tuple(inputs.values()), input_names=[*inputs], dynamo=True, verbose=False, optimize=True
        )
        program.save(file, external_data=True)
    # The exporter drops inputs that a step does not use.
    used = {value.name for value in program.model.graph.inputs}
    return {name: value.numpy() for name, value in inputs.items() if name in used}


class OnnxRuntime:
    """All optimisations of the graph, on all cores."""

    def __init__(self, file, inputs, cores):
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = cores
        options.log_severity_level = 3
        # Its threads would slow down the next peer.
        options.add_session_config_entry("session.force_spinning_stop", "1")
        self.session = onnxruntime.InferenceSession(file, options, providers=["CPUExecutionProvider"])
        self.inputs = inputs

    def step(self):
        return torch.from_numpy(self.session.run(None, self.inputs)[0])

    @staticmethod
    def quantised(file):
        """By its dynamic quantiser: weights in 8 bits, a scale for each output; inputs are rounded when it runs."""
        from onnxruntime.quantization import QuantType, quantize_dynamic

        other = file.with_suffix(".int8.onnx")
        logging.getLogger().setLevel(logging.ERROR)
        # Without VNNI, sums of 8-bit products overflow unless the weights have 7 bits.
        options = dict(per_channel=True, reduce_range="avx512_vnni" not in flags() and "avx_vnni" not in flags())
        quantize_dynamic(file, other, weight_type=QuantType.QInt8, op_types_to_quantize=["MatMul", "Gemm"], **options)
        return other


class OpenVino:
    """For the least latency, on all cores. Its own default is bf16 where the processor has it, else f32."""

    def __init__(self, file, inputs, cores, number_format):
        import openvino

        core = openvino.Core()
        model = core.read_model(file)
        if number_format == "int8":
            model = self.quantised(model, inputs)
        self.compiled = core.compile_model(
            model,
            "CPU",
            {
                "PERFORMANCE_HINT": "LATENCY",
                "INFERENCE_NUM_THREADS": cores,
                "INFERENCE_PRECISION_HINT": "bf16" if number_format == "bf16" else "f32",
            },
        )
        self.inputs = inputs

    def step(self):
        return torch.from_numpy(self.compiled(self.inputs)[0])

    @staticmethod
    def quantised(model, inputs):
        """By its quantiser, NNCF, calibrated on the input itself."""
        import nncf

        nncf.set_log_level(logging.ERROR)
        options = dict(model_type=nncf.ModelType.TRANSFORMER, subset_size=1)
        return nncf.quantize(model, nncf.Dataset([inputs]), **options)


def engines(case, number_format, folder, cores):
    """The engines that are installed and have this number format, each with a `step`."""
    wanted = {"onnxruntime": number_format != "bf16", "openvino": number_format != "bf16" or has_bf16()}
    if number_format == "int8":
        wanted["openvino"] = installed("nncf")
    wanted = [name for name, has_format in wanted.items() if has_format and installed(name)]
    if not case.is_exported or not wanted:
        return {}
    file = folder / "model.onnx"
    if case.exported is None:
        case.exported = export(case.at("f32"), file)
    inputs = case.exported
    found = {}
    if "onnxruntime" in wanted:
        of_format = OnnxRuntime.quantised(file) if number_format == "int8" else file
        found["onnxruntime"] = OnnxRuntime(of_format, inputs, cores)
    if "openvino" in wanted:
        found["openvino"] = OpenVino(file, inputs, cores, number_format)
    return found
